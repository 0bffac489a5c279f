"""An actor ready to run: its spec, checked against its own graph and against the robot."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnxruntime

from core.errors import InputError
from policy.adapters.registry import read_foreign_spec
from policy.graph import FRAME, NEXT_STATE, STATE, check_graph
from policy.metadata import SPEC_KEY, metadata_map, parse_metadata
from policy.observation import asks_for, bodies_looked_at, observation_layout, spec_dims
from policy.session import ORT_ERRORS, one_line, open_session
from policy.spec import ActorSpec, MotionInfo
from robot.robot import Robot

ACTORS_DIR = Path(__file__).parent / "actors"


class Inference(NamedTuple):
    """The graph's raw action (J,) float32, as it comes, and the state (n,) by name for the next tick."""

    action: np.ndarray
    state: dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Actor:
    """A loaded actor. ``sha256`` is that of the file; ``motion_npz`` the clip inside it, if any.

    ``action_name``: the graph's output that is the action. ``state_sizes``: what the graph carries from tick to tick,
    by name; it comes in as ``state.NAME`` and goes out as ``next_state.NAME``. ``constant``: inputs without influence
    on the action.
    """

    spec: ActorSpec
    sha256: str
    motion_npz: bytes | None
    path: Path
    session: onnxruntime.InferenceSession
    action_name: str
    state_sizes: Mapping[str, int]
    constant: Mapping[str, np.ndarray]

    def infer(self, observations: Mapping[str, np.ndarray], state: Mapping[str, np.ndarray] | None = None) -> Inference:
        """One tick: (n,) arrays per observation group and per name of ``state_sizes``; None: those of the start."""
        feed = {name: np.asarray(values, np.float32)[None] for name, values in observations.items()}
        carried = self.start_state() if state is None else state
        feed |= {STATE + name: values[None] for name, values in carried.items()} | dict(self.constant)
        action, *following = self.session.run([self.action_name, *map(NEXT_STATE.__add__, self.state_sizes)], feed)
        return Inference(action.reshape(-1), {n: v.reshape(-1) for n, v in zip(self.state_sizes, following)})

    def start_state(self) -> dict[str, np.ndarray]:
        """What the graph carries before its first tick: zeros."""
        return {name: np.zeros(size, np.float32) for name, size in self.state_sizes.items()}


def bundled_actors() -> list[str]:
    """Names of the actors that come with the project."""
    return sorted(path.parent.name for path in ACTORS_DIR.glob("*/actor.onnx"))


def load_actor(name_or_file: str | Path, robot: Robot, motion: MotionInfo | None = None) -> Actor:
    """Load a bundled actor by name, or any ``.onnx`` file, and check all that can be checked.

    ``motion`` describes the clip given beside the actor, its pose in the robot's joint order; an actor
    without a motion of its own needs it, one with its own refuses another. InputError names what does
    not fit: file, metadata, robot, graph.
    """
    path = resolve_actor(name_or_file)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path) from error
    session = open_session(content, path)
    spec, motion_npz = _read_spec(path, session, robot, motion)
    action_name, states = check_graph(path, spec, session)
    _check_bodies(path, spec, robot)
    constant = {entry.name: np.zeros((1, 1), np.float32) for entry in session.get_inputs() if entry.name == FRAME}
    sha256 = hashlib.sha256(content).hexdigest()
    actor = Actor(spec, sha256, motion_npz, path, session, action_name, states, constant)
    _try_out(actor)
    return actor


def resolve_actor(name_or_file: str | Path) -> Path:
    """The file of a bundled actor or the file itself. InputError, listing the bundled names, if neither."""
    name = str(name_or_file)
    if name in bundled_actors():
        return ACTORS_DIR / name / "actor.onnx"
    path = Path(name_or_file)
    if path.is_file():
        return path
    what = "is a folder, not an actor" if path.is_dir() else "no such actor"
    bundled = ", ".join(bundled_actors()) or "none"
    raise InputError(what, where=name, expected=f"a bundled actor ({bundled}) or an .onnx file")


def _read_spec(
    path: Path, session: onnxruntime.InferenceSession, robot: Robot, motion: MotionInfo | None
) -> tuple[ActorSpec, bytes | None]:
    entries = metadata_map(session)
    motion_npz = None
    if SPEC_KEY in entries:
        metadata = parse_metadata(entries, path)
        spec, motion_npz = metadata.spec, metadata.motion_npz
    else:
        spec = read_foreign_spec(path, entries, [entry.name for entry in session.get_inputs()], robot.name)
    _check_robot(path, spec, robot)
    return _with_motion(path, spec, robot, motion), motion_npz


def _check_robot(path: Path, spec: ActorSpec, robot: Robot) -> None:
    """Moved and held joints together are the robot's."""
    known = (*spec.joint_names, *(joint.name for joint in spec.held_joints))
    missing = [name for name in known if name not in robot.joint_names]
    extra = [name for name in robot.joint_names if name not in known]
    if missing or extra:
        parts = [f"the robot lacks {', '.join(missing)}"] if missing else []
        parts += [f"the actor lacks {', '.join(extra)}"] if extra else []
        raise InputError(
            f"the joints of actor and robot {robot.name!r} differ",
            where=path,
            got="; ".join(parts),
            expected="the same names",
            hint="give actors of this robot; in simulation --start reference needs no stand actor",
        )
    if spec.robot != robot.name:
        raise InputError("made for another robot", where=path, got=repr(spec.robot), expected=repr(robot.name))


def _check_bodies(path: Path, spec: ActorSpec, robot: Robot) -> None:
    """What terms look at is there."""
    if unknown := [body for body in bodies_looked_at(spec.observations) if body not in robot.body_names]:
        got, expected = ", ".join(unknown), ", ".join(robot.body_names)
        raise InputError(f"looks at a body that robot {robot.name!r} lacks", where=path, got=got, expected=expected)


def _with_motion(path: Path, spec: ActorSpec, robot: Robot, motion: MotionInfo | None) -> ActorSpec:
    if spec.follows == "commands":
        if motion is not None:
            raise InputError("this actor follows commands, not a motion", where=path, hint="leave --motion out")
        return spec
    if spec.motion is None and motion is None:
        missing = "--goal or --motion" if asks_for(spec.observations, "goal_visible") else "--motion"
        raise InputError(f"this actor carries no reference motion: give {missing}", where=path)
    if motion is None:
        return spec
    if spec.motion is None:
        pose = motion.start_joint_pos_rad[[robot.joint_names.index(name) for name in spec.joint_names]]
        return replace(spec, motion=replace(motion, start_joint_pos_rad=pose))
    if spec.motion.sha256 != motion.sha256:
        raise InputError(
            "the motion given is not the one this actor tracks",
            where=path,
            got=f"{motion.name!r} ({motion.sha256[:12]})",
            expected=f"{spec.motion.name!r} ({spec.motion.sha256[:12]})",
            hint="leave --motion out: the actor carries its own",
        )
    return spec


def _others(actor: Actor) -> dict[str, np.ndarray]:
    return {name: value + 7.0 for name, value in actor.constant.items()}


def _try_out(actor: Actor) -> None:
    spec = actor.spec
    dims = spec_dims(spec)
    zeros = {group.name: np.zeros(observation_layout(group, dims).size, np.float32) for group in spec.observations}
    try:
        action = actor.infer(zeros, actor.start_state()).action
    except ORT_ERRORS as error:
        raise InputError(f"the graph does not run ({one_line(error)})", where=actor.path) from error
    if action.shape != (spec.num_joints,):
        raise InputError("wrong action size", where=actor.path, got=action.size, expected=spec.num_joints)
    if actor.constant and not np.array_equal(action, replace(actor, constant=_others(actor)).infer(zeros).action):
        got = ", ".join(actor.constant)
        raise InputError("the action depends on what is never told", where=actor.path, got=got)
    if not np.isfinite(action).all():
        got = "a non-finite action for a zero observation"
        raise InputError("the graph is broken", where=actor.path, got=got, expected="finite numbers")
