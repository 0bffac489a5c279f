"""Actors by name or file, made ready to run on a robot, each with the motion that it tracks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from core.config import errors_in
from core.errors import InputError
from deploy.actor_run import ActorRun
from deploy.goals.clip import ClipGoal
from deploy.settings import ActorSettings, EntrySettings
from motion.clip import Clip, clip_from_bytes
from motion.clip_set import NamedClip
from motion.library import open_motion
from motion.reference import Reference, build_reference, joint_columns
from motion.tables import with_tables
from policy.actor import Actor, load_actor
from policy.observation import asks_for, reference_tables
from policy.spec import ActorSpec, motion_info
from policy.told_motion import check_told_motion
from robot.robot import Robot
from world.scene import Scene

ROUNDING = 1e-6
Bound = np.ndarray | float


def load_runs(
    policies: Sequence[str],
    clips: Sequence[NamedClip],
    robot: Robot,
    entry: EntrySettings,
    kind: str = "full",
) -> list[ActorRun]:
    """Each actor with each clip, or with its own where there are none; see :func:`load_run`."""
    return [load_run(policy, clip, robot, entry, kind) for policy in policies for clip in clips or (None,)]


def load_run(
    policy: str | Path, motion: NamedClip | str | Path | None, robot: Robot, entry: EntrySettings, kind: str = "full"
) -> ActorRun:
    """An actor with its reference: the clip inside its file, or the one given. Raises InputError on any misfit.

    kind: what an actor that follows goals is shown of it.
    """
    if isinstance(motion, str | Path):
        motion = NamedClip(Path(motion).stem, open_motion(motion, robot))
    clip, info = None, None
    if motion is not None:
        clip = motion.clip
        info = motion_info(clip, motion.name, clip.joint_pos_rad[0, joint_columns(clip, robot)])
    actor = load_actor(policy, robot, info)
    if asks := [*(command.name for command in actor.spec.commands), *(grid.name for grid in actor.spec.maps)]:
        got, expected = ", ".join(asks), "no commands and no maps: nothing gives them here"
        raise InputError("the actor asks for more than a motion", where=actor.path, got=got, expected=expected)
    if clip is None and actor.motion_npz is not None:
        clip = clip_from_bytes(actor.motion_npz, f"{actor.path}: motion")
        wanted = None if actor.spec.motion is None else actor.spec.motion.sha256
        if clip.sha256 != wanted:
            raise InputError(
                "the motion inside is not the one it names", where=actor.path, got=clip.sha256, expected=wanted
            )
    if clip is None:
        raise InputError("the actor carries no reference motion", where=actor.path, hint="give --motion")
    assert actor.spec.motion is not None, "it says which motion is inside"
    if kind != "full" and not follows_goals(actor.spec):
        raise InputError("this actor follows clips, not goals", where=actor.path, got=f"--goal {kind}", expected="full")
    with errors_in(f"motion {actor.spec.motion.name}"):
        reference = reference_for(actor.spec, clip, robot)
    columns = [robot.joint_names.index(name) for name in actor.spec.joint_names]
    check_told_motion(actor, reference.joint_pos_rad[:, columns])
    goal = ClipGoal(actor.spec.motion.name, clip, reference, start_pose_rad(actor, robot), kind)
    return ActorRun(actor, robot, entry, goal)


def reference_for(spec: ActorSpec, clip: Clip, robot: Robot) -> Reference:
    """The clip at every control tick, with all that this actor looks at."""
    reference = build_reference(clip, robot, spec.control_period_s)
    return with_tables(robot, reference, reference_tables(spec.observations))


def follows_goals(spec: ActorSpec) -> bool:
    """Whether the actor follows what is shown of a motion, whichever part that is."""
    return asks_for(spec.observations, "goal_visible")


def start_pose_rad(actor: Actor, robot: Robot) -> np.ndarray:
    """Where the actor takes over: its motion's first pose (J,), held joints included, in the robot's order."""
    assert actor.spec.motion is not None, "loaded with a motion"
    pose = dict(zip(actor.spec.joint_names, actor.spec.motion.start_joint_pos_rad))
    pose |= {joint.name: joint.pos_rad for joint in actor.spec.held_joints}
    return np.array([pose[name] for name in robot.joint_names], dtype=np.float64)


def check_bounds(run: ActorRun, robot: Robot, bounds: ActorSettings) -> None:
    """What an actor's file asks of the joints must suit the robot. Raises InputError naming joint and field."""
    spec = run.actor.spec
    period = spec.control_period_s
    _within(run, "control_period_s", [""], np.array([period]), *bounds.control_period_s)
    _within(run, "action_scale", spec.joint_names, spec.action_scale, 0.0, bounds.action_scale_rad)
    held = spec.held_joints
    names = (*spec.joint_names, *(joint.name for joint in held))
    pose, kp, kd = (
        np.concatenate([moved, [getattr(joint, field) for joint in held]])[robot.joint_index(names)]
        for moved, field in ((spec.default_pos_rad, "pos_rad"), (spec.kp, "kp"), (spec.kd, "kd"))
    )
    _within(run, "default_pos_rad", robot.joint_names, pose, robot.pos_lower_rad, robot.pos_upper_rad)
    low, high = bounds.gains
    _within(run, "kp", robot.joint_names, kp, low * robot.kp, high * robot.kp)
    _within(run, "kd", robot.joint_names, kd, low * robot.kd, high * robot.kd)


def check_start(run: ActorRun, stand: ActorRun, robot: Robot, entry: EntrySettings) -> None:
    """A motion must begin where the stand actor holds the robot. Raises InputError naming the joint farthest off."""
    away = np.abs(run.start_pose_rad - stand.start_pose_rad)
    joint = int(np.argmax(away))
    if away[joint] > entry.joint_rad:
        raise InputError(
            "does not begin in the stand pose", where=f"motion {run.name}",
            got=f"{robot.joint_names[joint]} {away[joint]:.2f} rad off it", expected=f"at most {entry.joint_rad} rad",
            hint="motion/process --input FILE makes a clip that begins and ends there",
        )  # fmt: skip


def _within(run: ActorRun, what: str, names: Sequence[str], values: np.ndarray, low: Bound, high: Bound) -> None:
    low, high = np.broadcast_to(low, values.shape), np.broadcast_to(high, values.shape)
    bad = np.flatnonzero((values < low - ROUNDING) | (values > high + ROUNDING))
    if bad.size:
        got = ", ".join(f"{names[i]} {values[i]:g}".strip() for i in bad[:3])
        expected = f"a number in [{low[bad[0]]:g}, {high[bad[0]]:g}]"
        raise InputError("not fit for this robot", where=f"{run.actor.path}: {what}", got=got, expected=expected)


def check_same_period(runs: list[ActorRun]) -> float:
    """The control period of all actors, in s. Raises InputError where they differ."""
    periods = {run.period_s for run in runs}
    if len(periods) > 1:
        got = ", ".join(f"{run.name} {run.period_s:g} s" for run in runs)
        raise InputError("actors of different control periods cannot share a loop", got=got)
    return periods.pop()


def check_same_scene(tracked: list[ActorRun]) -> Scene:
    """What the motions of all actors stand in. Raises InputError where they differ."""
    scenes = {run.scene for run in tracked}
    if len(scenes) > 1:
        raise InputError(
            "motions of different scenes", got=", ".join(run.name for run in tracked), expected="one scene"
        )
    return scenes.pop()
