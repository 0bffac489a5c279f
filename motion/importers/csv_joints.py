"""Mocap retargeted to the G1 with 29 or 23 joints: one line of numbers a frame, no header."""

from pathlib import Path

import numpy as np

from core.config import errors_in
from core.errors import InputError
from motion.clip import Clip
from motion.frames import MAX_FRAMES, check_frames
from motion.importers.g1_joints import JOINTS_23, JOINTS_29
from motion.importers.ground import on_the_ground
from motion.importers.pbhc_pkl import wxyz_of_xyzw
from robot.robot import Robot

DEFAULT_FPS = 60.0
ASSUMED = f"{DEFAULT_FPS:g} frames per second assumed: the file does not say"
ROOT_COLUMNS = 7
_JOINTS = {ROOT_COLUMNS + len(joints): joints for joints in (JOINTS_29, JOINTS_23)}


def read_csv_joints(content: bytes, where: str, robot: Robot, fps: float | None = None) -> Clip:
    """Clip of a CSV given as bytes: root x, y, z (m), root quaternion xyzw, 29 or 23 joints (rad) in the maker's order.

    The format does not state its frame rate: without `fps` it is taken as DEFAULT_FPS, and `created_by` says so. Wrists
    that the robot lacks are dropped. One height for the whole clip is subtracted, so that resting feet are
    on the ground. Contact is the rule of Eq. 2. Raises InputError naming `where`, line and column.
    """
    rows = _numbers(content, where)
    names = _JOINTS[rows.shape[1]]
    kept = [i for i, name in enumerate(names) if name in robot.joint_names or "wrist" not in name]
    assumed = f", {ASSUMED}" if fps is None else ""
    with errors_in(where):
        clip = Clip(
            fps=DEFAULT_FPS if fps is None else fps,
            joint_names=tuple(names[i] for i in kept),
            root_pos_w=rows[:, :3],
            root_quat_wxyz=wxyz_of_xyzw(rows[:, 3:ROOT_COLUMNS]),
            joint_pos_rad=rows[:, ROOT_COLUMNS:][:, kept],
            contact=np.zeros((len(rows), 2)),
            source=Path(where).name,
            license="not stated in the file",
            created_by=f"kata, from a {len(names)}-joint CSV{assumed}",
        )
    return on_the_ground(clip, robot, where)


def rate_assumed(clip: Clip) -> bool:
    """Whether how fast the clip is was nowhere said."""
    return clip.created_by.endswith(ASSUMED)


def _numbers(content: bytes, where: str) -> np.ndarray:
    """(N,36) or (N,30) float64 of the lines; empty lines at the end do not count."""
    expected = f"{' or '.join(str(n) for n in _JOINTS)}: root x y z, quaternion x y z w, 29 or 23 joints"
    content = content.rstrip()
    if (count := content.count(b"\n") + 1) > MAX_FRAMES:
        check_frames(count, where)
    try:
        lines = content.decode("utf-8-sig").split("\n")
    except UnicodeDecodeError as error:
        raise InputError("is not text", where=where, expected="a CSV of numbers") from error
    columns = lines[0].count(",") + 1
    if content and columns not in _JOINTS:
        raise InputError("wrong number of columns", where=f"{where}: line 1", got=columns, expected=expected)
    check_frames(len(lines), where)
    rows = np.empty((len(lines), columns))
    for number, line in enumerate(lines, start=1):
        cells = line.split(",")
        if len(cells) != columns:
            line_1 = f"{columns}, as in line 1"
            raise InputError(
                "wrong number of columns", where=f"{where}: line {number}", got=len(cells), expected=line_1
            )
        rows[number - 1] = [_number(cell, f"{where}: line {number}, column {i}") for i, cell in enumerate(cells, 1)]
    return rows


def _number(cell: str, where: str) -> float:
    try:
        return float(cell)
    except ValueError as error:
        hint = "the format has no header line"
        raise InputError("not a number", where=where, got=repr(cell[:40]), hint=hint) from error
