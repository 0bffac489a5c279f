"""Mocap retargeted to the 29-joint G1, one line of 36 numbers a frame, no header."""

import io
from dataclasses import replace
from pathlib import Path

import numpy as np

from motion.clip import Clip
from motion.feet import contact_mask, lowest_sole_m
from motion.importers.pbhc_pkl import wxyz_of_xyzw
from robot.errors import InputError
from robot.kinematics import Kinematics
from robot.robot import Robot

DEFAULT_FPS = 60.0
_LEG = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
_ARM = ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")
JOINT_NAMES = (
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in _LEG),
    *("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint"),
    *(f"{side}_{joint}_joint" for side in ("left", "right") for joint in _ARM),
)
COLUMNS = 7 + len(JOINT_NAMES)


def read_csv29(content: bytes, where: str, robot: Robot, fps: float = DEFAULT_FPS) -> Clip:
    """Clip of a CSV given as bytes: root x, y, z (m), root quaternion xyzw, 29 joints (rad) in the maker's order.

    The six wrist joints are dropped. One height for the whole clip is subtracted, so that the lowest sole point of all
    frames touches the ground. Contact is the rule of Eq. 2. Raises InputError naming `where`, line and column.
    """
    rows = _numbers(content, where)
    kept = [i for i, name in enumerate(JOINT_NAMES) if "wrist" not in name]
    joint_names = tuple(JOINT_NAMES[i] for i in kept)
    if len(rows) < 2:
        raise InputError("too few frames", where=where, got=len(rows), expected="2 or more lines")
    try:
        columns = robot.joint_index(joint_names)
        placed = Clip(
            fps=fps,
            joint_names=joint_names,
            root_pos_w=rows[:, :3],
            root_quat_wxyz=wxyz_of_xyzw(rows[:, 3:7]),
            joint_pos_rad=rows[:, 7:][:, kept],
            contact=np.zeros((len(rows), 2)),
            source=Path(where).name,
            license="not stated in the file",
            created_by="kata, from a 29-joint CSV",
        )
    except InputError as error:
        raise InputError(str(error), where=where) from error
    return _on_the_ground(placed, columns, robot)


def _on_the_ground(clip: Clip, columns: np.ndarray, robot: Robot) -> Clip:
    """`clip` with its lowest sole point at height 0 and its contact mask computed."""
    bodies = Kinematics(robot).forward(clip.root_pos_w, clip.root_quat_wxyz, clip.joint_pos_rad[:, columns])
    drop = np.array([0.0, 0.0, lowest_sole_m(robot, bodies.pos_w, bodies.quat_wxyz).min()])
    feet_w = bodies.pos_w[:, robot.tracked_index(robot.feet)] - drop
    return replace(clip, root_pos_w=clip.root_pos_w - drop, contact=contact_mask(feet_w, clip.fps))


def _numbers(content: bytes, where: str) -> np.ndarray:
    """(N,36) float64 of the lines; empty lines at the end do not count."""
    try:
        text = content.decode("utf-8-sig").rstrip()
    except UnicodeDecodeError as error:
        raise InputError("is not text", where=where, expected=f"a CSV of {COLUMNS} columns") from error
    rows = []
    for number, line in enumerate(io.StringIO(text), start=1):
        cells = line.split(",")
        if len(cells) != COLUMNS:
            expected = f"{COLUMNS}: root x y z, quaternion x y z w, 29 joints"
            raise InputError(
                "wrong number of columns", where=f"{where}: line {number}", got=len(cells), expected=expected
            )
        rows.append([_number(cell, f"{where}: line {number}, column {i}") for i, cell in enumerate(cells, start=1)])
    return np.array(rows, dtype=np.float64).reshape(-1, COLUMNS)


def _number(cell: str, where: str) -> float:
    try:
        return float(cell)
    except ValueError as error:
        hint = "the format has no header line"
        raise InputError("not a number", where=where, got=repr(cell[:40]), hint=hint) from error
