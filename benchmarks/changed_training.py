#!/usr/bin/env -S python3 -P
"""train/run.py with one idea of learning through a world model changed that no setting changes.

benchmarks/changed_training.py CHANGE KEY=VALUE ...

no_context          world model and critic are not told the robots' constants; delay and gains act as before
previous_targets    the world model sees the last two targets instead of those that act in each half of a step
plain_targets       the action is added to the reference's joints, without the torques that carry it
adaptive_tolerance  PBHC's rule: each tracking cost counts per running mean of its own error

benchmarks/ablations.py trains them all. Runs end with the program: such a run cannot be resumed.
"""

import contextlib
import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any
from unittest import mock

from train import run

ALPHA = 0.01  # of the running means, an update of the policy
NOT_TRACKING = ("torque", "wish_rate")


def _world_model(name: str) -> Any:
    return importlib.import_module(f"train.world_model.{name}")


@contextlib.contextmanager
def no_context() -> Iterator[None]:
    """What networks see of the context is zero."""
    original = _world_model("context").context_of

    def untold(packed: Any, num_joints: int) -> Any:
        context = original(packed, num_joints)
        return context._replace(features=0.0 * context.features)

    with contextlib.ExitStack() as stack:
        for name in ("imagination", "fitting", "comparison", "blindness"):
            stack.enter_context(mock.patch.object(_world_model(name), "context_of", untold))
        yield


@contextlib.contextmanager
def previous_targets() -> Iterator[None]:
    """In the first half of a step the target before acts, in the second one the newest; gains are as they should be."""
    model = _world_model("model").WorldModel
    original = model.inputs

    def inputs(self: Any, motion: Any, gravity_b: Any, targets: Any, context: Any) -> Any:
        now, one = context.early.new_tensor([1.0, 0.0, 0.0]), context.kp_scale * 0.0 + 1.0
        usual = context._replace(
            kp_scale=one, kd_scale=one, torque_offset_nm=0.0 * one,
            early=now.roll(1).expand_as(context.early), late=now.expand_as(context.late),
        )  # fmt: skip
        return original(self, motion, gravity_b, targets, usual)

    with mock.patch.object(model, "inputs", inputs):
        yield


@contextlib.contextmanager
def plain_targets() -> Iterator[None]:
    """The reference's joints alone carry, in training and in the exported actor."""

    def plain(reference: Any, feedforward: Any) -> Any:
        return reference + 0.0 * feedforward

    with contextlib.ExitStack() as stack:
        for name in ("policy", "imagination"):
            stack.enter_context(mock.patch.object(_world_model(name), "carrying_targets", plain))
        yield


@contextlib.contextmanager
def adaptive_tolerance() -> Iterator[None]:
    """σ ← min(σ, running mean of the error); at first a cost is what it is without."""
    from train.mdp.adaptive_sigma import AdaptiveSigma

    original = _world_model("cost").terms_of
    sigmas: dict[str, tuple[float, AdaptiveSigma]] = {}

    def terms_of(imagined: Any, weights: Mapping[str, float]) -> dict[str, Any]:
        terms = original(imagined, weights)
        for name in terms.keys() - NOT_TRACKING:
            means = terms[name].detach().mean()
            first, sigma = sigmas.setdefault(name, (float(means), AdaptiveSigma({name: float(means)}, ALPHA)))
            sigma.update(means.view(1, 1))
            terms[name] = terms[name] * (first / float(sigma.sigma))
        return terms

    with mock.patch.object(_world_model("policy_learning"), "terms_of", terms_of):
        yield


CHANGES: dict[str, Callable[[], contextlib.AbstractContextManager[None]]] = {
    change.__name__: change for change in (no_context, previous_targets, plain_targets, adaptive_tolerance)
}


def main(arguments: list[str]) -> int:
    """Train; return the exit code of train/run.py, 2 for an unknown change."""
    if arguments[:1] in (["-h"], ["--help"]):
        print(__doc__)
        return 0
    if not arguments or arguments[0] not in CHANGES:
        given = arguments[0] if arguments else "nothing"
        print(f"error: unknown change, got {given}, expected one of {', '.join(CHANGES)}", file=sys.stderr)
        return 2
    with CHANGES[arguments[0]]():
        return run.main(arguments[1:])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
