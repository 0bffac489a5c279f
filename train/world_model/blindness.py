"""Where the world model is blind: its error of one step where robots land, slip, or meet a limit."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from core.rotations import projected_gravity
from robot.robot import Robot
from train.mdp.state import EnvState
from train.mdp.tracking import CONTACT_FORCE_N
from train.world_model.context import context_of
from train.world_model.fitting import ModelFitting
from train.world_model.ring import Ring
from train.world_model.state import unpack

if TYPE_CHECKING:
    from train.world_model.learner import WorldModelLearner

STEPS = 100
SLIP_M_S = 0.15
NEAR_LIMIT_RAD = 0.02
NEAR_LIMIT_SHARE = 0.99
TILTED = 0.5  # of the length of gravity's direction, off the vertical


@dataclass(frozen=True)
class BlindSpot:
    """``share``: of all steps of which ``what`` is true; ``ratio``: the mean error in them, over that of all others."""

    what: str
    share: float
    ratio: float

    def __str__(self) -> str:
        return f"{self.what}: {100 * self.share:.1f} % of the steps, {self.ratio:.1f} times the error of the others"


def describe(state: EnvState, robot: Robot) -> dict[str, Tensor]:
    """What is true (B,) of robots now."""
    physics = state.physics
    feet, on = robot.tracked_index(robot.feet), physics.joint_pos_rad.device
    touching = physics.foot_force_w.norm(dim=-1) > CONTACT_FORCE_N
    sliding = state.bodies.lin_vel_w[:, feet, :2].norm(dim=-1) > SLIP_M_S
    low, high = (torch.tensor(bound, device=on).float() + sign * NEAR_LIMIT_RAD for bound, sign in (
        (robot.pos_lower_rad, 1), (robot.pos_upper_rad, -1)
    ))  # fmt: skip
    q = physics.joint_pos_rad
    torque = physics.torque_nm.abs() / torch.tensor(robot.torque_limit_nm, device=on).float()
    return {
        "left": touching[:, 0],
        "right": touching[:, 1],
        "slips": (touching & sliding).any(dim=1),
        "joint": ((q < low) | (q > high)).any(dim=1),
        "motor": (torque > NEAR_LIMIT_SHARE).any(dim=1),
        "tilted": projected_gravity(physics.root_quat_wxyz)[:, :2].norm(dim=1) > TILTED,
    }


@torch.no_grad()
def blind_spots(learner: "WorldModelLearner", robot: Robot, observations: Mapping[str, Tensor]) -> list[BlindSpot]:
    """Let the robots go on for some steps from ``observations`` on, and compare each with what the model foretells."""
    env, ring, seen = learner.env, learner.ring, []
    moments = min(STEPS, ring.steps - 2)  # a queue of targets reaches back by two steps more
    for _ in range(moments):
        seen.append(describe(env.state, robot))
        result = env.step(learner.act(observations))
        learner.record(result)
        observations = result.observations
    told = {name: torch.stack([moment[name] for moment in seen]) for name in seen[0]}
    steps = moments - 1
    passed = torch.arange(steps, device=ring.device)
    times = ((ring.next - moments + passed) % ring.steps)[:, None].expand(steps, ring.num_envs).flatten()
    robots = torch.arange(ring.num_envs, device=ring.device).repeat(steps)
    whole = ring.segments(times, robots) == ring.segments((times + 1) % ring.steps, robots)
    first = {name: values[:-1].flatten()[whole] for name, values in told.items()}
    then = {name: values[1:].flatten()[whole] for name, values in told.items()}
    losses = _losses(learner.fitting, ring, times[whole], robots[whole])
    groups = {
        "a foot lands or lifts": (first["left"] != then["left"]) | (first["right"] != then["right"]),
        "a foot slips": first["slips"] | then["slips"],
        "no foot bears": ~(first["left"] | first["right"]),
        "a joint at its end": first["joint"] | then["joint"],
        "a motor at its limit": then["motor"],
        "tilted": first["tilted"],
    }
    return [
        BlindSpot(what, float(true.float().mean()), float(losses[true].mean() / losses[~true].mean()))
        for what, true in groups.items()
        if true.any() and not true.all()
    ]


def _losses(fitting: ModelFitting, ring: Ring, times: Tensor, robots: Tensor) -> Tensor:
    """The fitting's loss (n,) of single steps."""
    model = fitting.model
    before = ring.at(times, robots)
    context = context_of(before.context, before.target.shape[1])
    queue = ring.targets_before(times, robots, before.age, before.target)
    model.prepare()
    played = model.play(unpack(before.state), [before.target], queue, context)[0]
    return fitting.losses(played, unpack(ring.states((times + 1) % ring.steps, robots)))
