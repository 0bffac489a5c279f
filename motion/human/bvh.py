"""Recordings in BVH files: skeletons known by their names, of any rest pose, axes and common unit."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.errors import InputError
from core.rotations import quat_conjugate, quat_mul
from motion.frames import choose_fps
from motion.human.bvh_file import Bvh, parse_bvh
from motion.human.bvh_pose import bvh_pose, t_pose_values
from motion.human.motion import ANKLES
from motion.human.placing import FileMotion
from motion.human.skeleton import FEET
from motion.human.skeleton_map import SkeletonMap, load_skeleton_map, recognised
from motion.human.t_pose import BONES, TOE_SHARE, feet_of, t_pose_of

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "cmu": 0.0254 / 0.45}
LEG_M = (0.6, 1.1)  # hip to ankle of grown people, so narrow that no two units fit
GIVEN_UNIT_LEG_M = (0.2, 2.0)
PUT_IN_FRONT = (0.7, 0.5)  # a first frame with at least so many values zero before one with at most so many
MAX_LEG_CHANGE = 0.2  # of its length in the T-pose
RATES_HZ = (24, 25, 30, 48, 50, 60, 72, 75, 90, 96, 100, 120, 144, 150, 180, 200, 240, 250, 300, 360, 480, 500)
_LEGS = tuple(bone for index, bone in enumerate(BONES) if index % 4 < 2)


@dataclass(frozen=True, eq=False)
class _Rest:
    """The skeleton before it moves: metres in the file's unit, length of a leg, correction_wxyz (22,4) behind the
    file's rotations, the feet (see feet_of), the up-axis and a sentence about the unit."""

    unit_m: float
    leg_m: float
    correction_wxyz: np.ndarray
    sole_m: np.ndarray
    foot_m: np.ndarray
    up: str
    note: str


def bvh_motion(content: bytes, where: str, *, fps: float | None, unit: str | None, skeleton: Path | None) -> FileMotion:
    """The motion of a BVH file given as bytes.

    `skeleton` is a mapping file for one that is not recognised, `unit` one of UNITS_M where the size does not tell,
    `fps` counts more than the file's frame time. Raises InputError naming `where` and the line or joint.
    """
    bvh = parse_bvh(content, where)
    rate, fps_note = choose_fps(fps, _stated_fps(bvh.frame_time_text, where, given=fps is not None), where)
    mapping, prefix = _mapping(bvh, skeleton, where)
    theirs = {ours: prefix + name for ours, name in mapping.joints.items()}
    rest = _rest(bvh, mapping, prefix, unit, where)
    values, values_note = _without_t_pose(bvh.values)
    pos, quat = bvh_pose(bvh, values, theirs)
    leg_m = _leg(pos) * rest.unit_m
    if abs(leg_m / rest.leg_m - 1.0) > MAX_LEG_CHANGE:
        got = f"legs of {leg_m:.3g} m, of {rest.leg_m:.3g} m by their offsets"
        raise InputError("offsets and position channels contradict each other", where=where, got=got)
    if mapping.at_toe:
        feet, ankles = list(FEET), list(ANKLES)
        pos[:, feet] = pos[:, ankles] + TOE_SHARE * (pos[:, feet] - pos[:, ankles])
    return FileMotion(
        fps=rate,
        pos_m=pos * rest.unit_m,
        quat_wxyz=quat_mul(quat, np.broadcast_to(rest.correction_wxyz, quat.shape)),
        sole_m=rest.sole_m,
        foot_m=rest.foot_m,
        kind="skeletons of this rest pose",
        usual_up=rest.up,
        notes=(f"Read as a BVH with the skeleton {mapping.name}.", *values_note, fps_note, rest.note),
    )


def _rest(bvh: Bvh, mapping: SkeletonMap, prefix: str, unit: str | None, where: str) -> _Rest:
    """The skeleton in its T-pose."""
    theirs = {ours: prefix + name for ours, name in mapping.joints.items()}
    pose_deg = {prefix + name: channels for name, channels in mapping.t_pose_deg.items()}
    pos, quat = bvh_pose(bvh, t_pose_values(bvh, pose_deg), theirs)
    unit_m, note = _unit(_leg(pos), unit, where)
    pos_m, leg_m = pos[0] * unit_m, _leg(pos) * unit_m
    t_pose = t_pose_of(pos_m, where)
    sole_m, foot_m = feet_of(pos_m, t_pose, leg_m, at_toe=mapping.at_toe, above_sole_m=mapping.above_sole_m)
    correction = quat_mul(quat_conjugate(quat[0]), t_pose.segment_wxyz)
    return _Rest(unit_m, leg_m, correction, sole_m, foot_m, t_pose.up, note)


def _mapping(bvh: Bvh, skeleton: Path | None, where: str) -> tuple[SkeletonMap, str]:
    """The map and the prefix that the file's names have."""
    names = tuple(joint.name for joint in bvh.joints)
    mapping = recognised(names, where) if skeleton is None else load_skeleton_map(skeleton)
    prefix = mapping.prefix_in(names)
    if prefix is None:
        missing = [name for name in (*mapping.joints.values(), *mapping.t_pose_deg) if name not in names]
        got = f"no {', '.join(missing)}"[:200]
        raise InputError("joints of the mapping are missing", where=where, got=got, expected=f"those of {skeleton}")
    return mapping, prefix


def _without_t_pose(values: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Channel values (N,C) without the rest pose that some programs put in front, and a sentence about it."""
    zeros = (values[:2] == 0.0).mean(axis=1)
    if len(values) < 3 or zeros[0] < PUT_IN_FRONT[0] or zeros[1] > PUT_IN_FRONT[1]:
        return values, ()
    return values[1:], ("The first frame, a rest pose put in front of the recording, was left out.",)


def _stated_fps(frame_time_text: str, where: str, *, given: bool) -> float | None:
    """The frame rate of a frame time in s, which as written stands for any that rounds to it: the common rate among
    those. None where it is not positive and another is `given`."""
    frame_time = float(frame_time_text)
    if frame_time <= 0.0:
        if given:
            return None
        hint = "if the file is wrong, give the frame rate: --fps F"
        raise InputError("frame time is not positive", where=where, got=f"{frame_time_text[:20]} s", hint=hint)
    digits = len(frame_time_text.partition(".")[2]) if "e" not in frame_time_text.lower() else 12
    fitting = [rate for rate in RATES_HZ if abs(1.0 / rate - frame_time) <= 0.5001 * 10.0**-digits]
    return float(min(fitting, key=lambda rate: abs(1.0 / rate - frame_time))) if fitting else 1.0 / frame_time


def _unit(leg: float, given: str | None, where: str) -> tuple[float, str]:
    """Metres in the file's unit, and a sentence about it. `leg` is the length of a leg in that unit."""
    if given is not None:
        if given not in UNITS_M:
            raise InputError("unknown unit", where="unit", got=given, expected=f"one of {', '.join(UNITS_M)}")
        if not GIVEN_UNIT_LEG_M[0] <= leg * UNITS_M[given] <= GIVEN_UNIT_LEG_M[1]:
            expected = f"legs of {GIVEN_UNIT_LEG_M[0]:g} to {GIVEN_UNIT_LEG_M[1]:g} m"
            raise InputError(f"wrong unit {given}", where=where, got=f"{leg * UNITS_M[given]:.3g} m", expected=expected)
        return UNITS_M[given], f"The unit is {_text(given)}, as given: legs of {leg * UNITS_M[given]:.3f} m."
    fitting = [unit for unit, metres in UNITS_M.items() if LEG_M[0] <= leg * metres <= LEG_M[1]]
    if not fitting:
        got = f"legs of {leg:.4g} units"
        expected = f"{LEG_M[0]:g} to {LEG_M[1]:g} m from hip to ankle in one of {', '.join(UNITS_M)}"
        raise InputError("unclear unit", where=where, got=got, expected=expected, hint="say it: --unit UNIT")
    leg_text = f"{leg * UNITS_M[fitting[0]]:.3f} m"
    return UNITS_M[fitting[0]], f"The unit is {_text(fitting[0])}: only so do the legs, {leg_text}, fit a grown person."


def _text(unit: str) -> str:
    return f"{unit} ({UNITS_M[unit]:.4g} m)" if unit != "m" else "m"


def _leg(pos: np.ndarray) -> float:
    """Length of a leg from hip to ankle, mean of both, median of the frames (N,22,3)."""
    bones: Iterable[np.ndarray] = (np.linalg.norm(pos[:, child] - pos[:, joint], axis=1) for joint, child in _LEGS)
    return float(sum(np.median(bone) for bone in bones)) / 2.0
