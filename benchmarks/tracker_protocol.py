#!/usr/bin/env -S python3 -P
"""Scores an actor of any clip by the protocol of the field's many-clip trackers.

Each clip is played once, in the training simulation, from its exact first frame, without noise and randomisation. It is
lost where the pelvis is off by more than 0.25 m of height, or gravity by more than 0.8. Its return is the sum of
BeyondMimic's six tracking rewards until then, over what a perfect robot would get for the whole clip.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from core.arguments import ArgumentParser
from core.command import guarded
from core.errors import InputError
from core.files import check_output_file, write_json
from core.rotations import quat_conjugate, quat_mul, quat_rotate, yaw_quat
from motion.clip_set import open_clips
from motion.reference import Reference, build_reference
from policy.actor import Actor, load_actor
from policy.spec import motion_info
from robot.robot import load_robot
from train.config import check, compose_document
from train.mdp.evaluator import whole_clip
from train.mdp.factory import build_environment
from train.mdp.settings import EnvironmentSettings, StartSettings, TerminationSettings
from train.mdp.tick import StepOutcome
from train.mdp.tracking import CONTROL_PERIOD_S, TrackingEnv

ANCHOR = "torso_link"
LOST = {"tilt_error": {"limit": 0.8}, "height_error": {"limit_m": 0.25}}
# BeyondMimic's weights and widths: m, rad, m, rad, m/s, rad/s.
WEIGHTS = (0.5, 0.5, 1.0, 1.0, 1.0, 1.0)
WIDTHS = (0.3, 0.4, 0.3, 0.4, 1.0, 3.14)


def rewards(t: StepOutcome, anchor: int) -> Tensor:
    """The six terms (B, 6), weighted: place and orientation of the anchor, of the bodies seen from it, velocities."""
    body, ref = t.bodies, t.reference
    place, ref_place = body.pos_w[:, anchor], ref.body_pos_w[:, anchor]
    turn, ref_turn = body.quat_wxyz[:, anchor], ref.body_quat_wxyz[:, anchor]
    heading = yaw_quat(quat_mul(turn, quat_conjugate(ref_turn)))[:, None]
    # The reference's bodies, moved and turned about the vertical to where the robot's anchor is.
    on_spot = torch.cat([place[:, :2], ref_place[:, 2:]], dim=1)[:, None]
    wanted_pos = on_spot + quat_rotate(heading, ref.body_pos_w - ref_place[:, None])
    wanted_quat = quat_mul(heading.expand_as(ref.body_quat_wxyz), ref.body_quat_wxyz)
    errors = [
        (place - ref_place).square().sum(dim=-1),
        _angle(turn, ref_turn).square(),
        (body.pos_w - wanted_pos).square().sum(dim=-1).mean(dim=-1),
        _angle(body.quat_wxyz, wanted_quat).square().mean(dim=-1),
        (body.lin_vel_w - ref.body_lin_vel_w).square().sum(dim=-1).mean(dim=-1),
        (body.ang_vel_w - ref.body_ang_vel_w).square().sum(dim=-1).mean(dim=-1),
    ]
    widths = torch.tensor(WIDTHS).square()
    return torch.tensor(WEIGHTS) * torch.exp(-torch.stack(errors, dim=-1) / widths)


def _angle(a: Tensor, b: Tensor) -> Tensor:
    """Between rotations, rad."""
    return 2.0 * torch.acos((a * b).sum(dim=-1).abs().clamp(max=1.0))


class _Scored:
    """Stands in for the environment's rewards and keeps the protocol's."""

    def __init__(self, inner: Any, anchor: int) -> None:
        self._inner, self._anchor = inner, anchor
        self.latest = torch.zeros(0)

    def of(self, t: StepOutcome, penalty_scale: float) -> Tensor:
        self.latest = rewards(t, self._anchor)
        return self._inner.of(t, penalty_scale)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def settings_for(actor: Actor, references: Sequence[Reference]) -> EnvironmentSettings:
    """The training environment as the protocol has it, with what the actor sees."""
    settings = check(compose_document(["motion=stand", "train=tracker"])).environment
    settings = replace(settings, observations=actor.spec.observations[0].terms)
    nominal = whole_clip(settings, *references)["nominal"]
    return replace(
        nominal,
        start=StartSettings(first_frame=1.0, first_frame_at_rest=False),
        termination=TerminationSettings(terms=dict(LOST), max_episode_s=1e9),
    )


def play(env: TrackingEnv, act: Callable[[Tensor], Tensor], anchor: int) -> list[dict[str, float]]:
    """Each robot's clip: length played and return as shares, and whether it was lost."""
    scored = _Scored(env.rewards, anchor)
    env.rewards = scored  # type: ignore[assignment]
    observations = env.reset()["actor"]
    ticks = env.command.num_ticks[env.state.clip].float()
    playing, lost = torch.ones(env.num_envs, dtype=torch.bool), torch.zeros(env.num_envs, dtype=torch.bool)
    total, steps = torch.zeros(env.num_envs), torch.zeros(env.num_envs)
    while playing.any():
        result = env.step(act(observations))
        observations = result.observations["actor"]
        lost |= result.terminated & playing
        playing &= ~result.terminated
        total += scored.latest.sum(dim=1) * playing
        steps += playing
        playing &= ~result.timed_out
    perfect = sum(WEIGHTS) * ticks
    return [
        {"return": float(a), "length": float(b), "lost": float(c)}
        for a, b, c in zip(total / perfect, (steps / ticks).clamp(max=1.0), lost, strict=True)
    ]


def score(policy: str, motions: Sequence[str], threads: int) -> dict[str, dict[str, float]]:
    """The figures of each clip by name. Raises InputError on any misfit."""
    torch.set_num_threads(threads)
    robot = load_robot()
    clips = open_clips(motions, robot)
    if not clips:
        raise InputError("no motion", where="--motion")
    references = {clip.name: build_reference(clip.clip, robot, CONTROL_PERIOD_S) for clip in clips}
    first = clips[0]
    actor = load_actor(policy, robot, motion_info(first.clip, first.name, first.clip.joint_pos_rad[0]))
    env = build_environment(
        settings_for(actor, [*references.values()]), robot, references,
        num_envs=len(references), seed=0, threads=threads,
    )  # fmt: skip
    figures = play(env, _acting(actor), robot.tracked_index([ANCHOR])[0])
    return dict(zip(references, figures, strict=True))


def _acting(actor: Actor) -> Callable[[Tensor], Tensor]:
    name = actor.spec.observations[0].name

    def act(observations: Tensor) -> Tensor:
        rows = [actor.infer({name: row}).action for row in observations.numpy()]
        return torch.from_numpy(np.stack(rows))

    return act


@guarded
def main(arguments: list[str]) -> int:
    """Score; print a row a clip and the means. Returns the exit code."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--policy", required=True, metavar="NAME|FILE")
    parser.add_argument("--motion", action="append", required=True, metavar="SET|FILE")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="F")
    options = parser.parse_args(arguments)
    check_output_file("--json", options.json)
    figures = score(options.policy, options.motion, options.threads)
    print(f"{'clip':32}{'return':>8}{'length':>8}{'lost':>6}")
    for name, row in figures.items():
        print(f"{name:32}{row['return']:8.3f}{row['length']:8.3f}{'yes' if row['lost'] else 'no':>6}")
    mean = {key: float(np.mean([row[key] for row in figures.values()])) for key in ("return", "length", "lost")}
    lost = round(mean["lost"] * len(figures))
    print(f"{'mean':32}{mean['return']:8.3f}{mean['length']:8.3f}{lost:>6} of {len(figures)}")
    if options.json:
        write_json(options.json, {"clips": figures, "mean": mean})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
