"""The teacher: a tracker's policy with its weights as they are, of a run or of an actor's file."""

from collections.abc import Mapping

import torch
from torch import Tensor

from core.errors import InputError
from policy.spec import ObservationGroup
from robot.robot import Robot
from train.learner.networks import ActorNetwork
from train.learner.transfer import misfits
from train.mdp.tracking import ACTION_SCALE
from train.world_model.policy import BoundedResidual, CarryingTargets, Layout

_FIRST = "mlp.network.first.weight"
_NO_NOISE = (1.0, 1.0, 1.0)


def teacher_of(weights: Mapping[str, Tensor], robot: Robot, group: ObservationGroup) -> ActorNetwork:
    """The actor of ``train=tracker`` with such weights, as it is deployed: fp32, no gradients.

    Args:
        weights: of the actor by name; the sizes of its layers follow from them.
        robot: whose joints it moves.
        group: what it sees.

    Raises:
        InputError: weights of another network, or for another observation.
    """
    layout = Layout(group, robot.num_joints)
    residual = BoundedResidual(robot, layout, _hidden(weights), ACTION_SCALE, torch.Generator("cpu"), "fp32")
    actor = ActorNetwork(residual, robot.num_joints, _NO_NOISE, CarryingTargets(layout, ACTION_SCALE))
    own = {name: value for name, value in actor.state_dict().items() if name != "log_std"}
    if lines := misfits(own, weights):
        raise _no_tracker("; ".join(lines[:3]))
    for name, value in own.items():
        value.copy_(weights[name])
    return actor.deployed()


def _hidden(weights: Mapping[str, Tensor]) -> list[int]:
    """Sizes of the hidden layers."""
    if _FIRST not in weights:
        raise _no_tracker(f"no {_FIRST}")
    hidden = [len(weights[_FIRST])]
    while (name := f"mlp.network.hidden.{len(hidden) - 1}.weight") in weights:
        hidden.append(len(weights[name]))
    return hidden


def _no_tracker(got: str) -> InputError:
    return InputError("no tracker's weights", where="teacher", got=got, expected="a run or an actor of train=tracker")
