"""The command `deploy/replay`: a log's states through an actor again, and the first term that comes out otherwise."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.arguments import ArgumentParser, number_argument, path_argument
from core.command import guarded
from core.errors import InputError
from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.goals.clip import ClipGoal
from deploy.goals.option import parse_goal
from deploy.record.read_log import LoggedTick, read_log
from deploy.settings import load_settings
from policy.controller import PolicyController, PolicyOutput
from policy.observation import entry_size, spec_dims
from policy.spec import ActorSpec
from robot.robot import Robot, load_robot

SAME, DIFFERENT = 0, 1
STATE_FIELDS = ("imu_quat_wxyz", "imu_ang_vel_b", "joint_pos_rad", "joint_vel_rad_s")


@dataclass(frozen=True)
class Difference:
    """The first value that differs. term: as in `dof_vel[1] left_knee_joint`; logged, replayed: the two values."""

    tick: int
    time_s: float
    term: str
    logged: float
    replayed: float

    def __str__(self) -> str:
        values = f"log {self.logged:.9g}, replay {self.replayed:.9g}"
        return f"first difference at tick {self.tick} (t = {self.time_s:.3f} s): {self.term}: {values}"


def ticks_of(run: ActorRun, ticks: Sequence[LoggedTick], where: Path) -> list[LoggedTick]:
    """Those of this very actor with this motion; where there are none, all of this actor, or of others with the motion.

    Raises InputError where there are none at all.
    """
    own = [tick for tick in ticks if tick.action["policy_sha256"] == run.actor.sha256]
    chosen = [tick for tick in own or ticks if tick.action["motion"] == run.name] or own
    if not chosen:
        got = ", ".join(sorted({f"{tick.action['motion']} ({tick.action['policy_sha256'][:12]})" for tick in ticks}))
        expected = f"{run.name} ({run.actor.sha256[:12]})"
        raise InputError("holds no tick of this actor", where=where, got=got or "no actor", expected=expected)
    return chosen


def first_difference(run: ActorRun, robot: Robot, ticks: Sequence[LoggedTick], tolerance: float) -> Difference | None:
    """Feed the states to the actor as the loop did; None where everything agrees within the tolerance."""
    spec, controller = run.actor.spec, PolicyController(run.actor, robot)
    assert isinstance(run.goals, ClipGoal), "loaded with a clip"
    for number, tick in enumerate(ticks):
        if tick.action["tick"] == 0 or number == 0:
            controller.reset()
        now = tick.action["tick"]
        goal = run.goals.at(now)
        quat, ang_vel, pos, vel = (_array(tick.state[name]) for name in STATE_FIELDS)
        shown = {"reference": goal.reference, "tick": now, "visible": goal.visible}
        output = controller.act(quat, ang_vel, pos, vel, goal.phase, **shown)
        for term, logged, replayed in _pairs(spec, robot, tick, output):
            if not _close(logged, replayed, tolerance):
                return Difference(now, tick.time_s, term, logged, replayed)
    return None


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 0 where the replay agrees, 1 where it differs, 2 on bad input."""
    parser = ArgumentParser(prog="deploy/replay", description=__doc__, allow_abbrev=False)
    parser.add_argument("log", type=path_argument, help="an MCAP file that deploy/run --log wrote")
    parser.add_argument("--policy", required=True, metavar="NAME|FILE")
    parser.add_argument("--motion", metavar="NAME|FILE", help="the clip, for actors that do not carry it")
    parser.add_argument("--goal", metavar="clip:FILE[:KIND]", help="likewise, for actors that follow goals")
    parser.add_argument("--robot", default="g1_23dof", metavar="NAME|FILE")
    parser.add_argument(
        "--tolerance", type=number_argument, default=1e-5, metavar="T", help="largest difference of a term that is none"
    )
    given = parser.parse_args(arguments)
    robot = load_robot(given.robot)
    run = _loaded(given.policy, given.motion, given.goal, robot)
    log = read_log(given.log)
    if log.joint_names != robot.joint_names:
        raise InputError("the log is of another robot", where=given.log, expected=robot.name)
    if log.cut is not None:
        print(f"{given.log} was not closed ({log.cut}): replaying the {len(log.ticks)} ticks that are whole")
    chosen = ticks_of(run, log.ticks, given.log)
    difference = first_difference(run, robot, chosen, given.tolerance)
    print(difference or f"{len(chosen)} ticks agree within {given.tolerance:g}")
    return SAME if difference is None else DIFFERENT


def _loaded(policy: str, motion: str | None, goal: str | None, robot: Robot) -> ActorRun:
    entry = load_settings().entry
    if goal is None:
        return load_run(policy, motion, robot, entry)
    option = parse_goal(goal)
    if option.steered:
        raise InputError("only clips are replayed", where="--goal", got=goal, expected="clip:FILE[:KIND]")
    return load_run(policy, option.file, robot, entry, option.kind)


def _pairs(spec: ActorSpec, robot: Robot, tick: LoggedTick, output: PolicyOutput) -> Iterator[tuple[str, float, float]]:
    """(label, logged, replayed) of every number, in the order in which the actor depends on them."""
    groups = tick.observation["groups"]
    for group in spec.observations:
        labels = _labels(group.terms, spec)
        yield from zip(labels, _array(groups[group.name]).tolist(), output.observation[group.name].tolist())
    for name, values in (("action", output.action), ("target_rad", output.target_rad)):
        labels = [f"{name} {joint}" for joint in robot.joint_names]
        yield from zip(labels, _array(tick.action[name]).tolist(), values.tolist())


def _labels(terms: Sequence[Any], spec: ActorSpec) -> list[str]:
    dims = spec_dims(spec)
    labels = []
    for term in terms:
        size = entry_size(term, dims)
        parts = spec.joint_names if size == spec.num_joints else [str(i) for i in range(size)]
        labels += [f"{term.term}[{moment}] {part}" for moment in term.moments for part in parts]
    return labels


def _array(values: Sequence[float | None]) -> np.ndarray:
    return np.array([math.nan if value is None else value for value in values])


def _close(a: float, b: float, tolerance: float) -> bool:
    return abs(a - b) <= tolerance or (math.isnan(a) and math.isnan(b))
