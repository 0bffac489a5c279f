"""Motions of BeyondMimic (Isaac Lab) and mjlab: an .npz of joints and bodies of the G1, without their names."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from core.config import errors_in
from core.errors import InputError
from motion.clip import Clip
from motion.frames import check_frames, choose_fps
from motion.importers.g1_joints import JOINTS_23, JOINTS_29, by_depth, link_names
from motion.importers.ground import on_the_ground
from robot.robot import Robot

FIELDS = frozenset({"fps", "joint_pos", "body_pos_w", "body_quat_w"})
MAX_BODY_ERROR_M = 0.03  # in the mean: models of the same robot differ by millimetres, orders by decimetres
CHECKED_FRAMES = 50
_ORDERS = {"limb by limb (mjlab)": lambda joints: joints, "by depth (Isaac Lab)": by_depth}


def read_mjlab(arrays: Mapping[str, np.ndarray], where: str, robot: Robot, fps: float | None = None) -> Clip:
    """Clip of the arrays of such a file: joint_pos (N,J) rad, body_pos_w (N,J+1,3) m, body_quat_w (N,J+1,4) wxyz, fps.

    The two programs order joints differently and do not say how: the order is the one in which the robot's forward
    kinematics gives the bodies of the file. Resting feet are put on the ground, contact is the rule of Eq. 2; wrists
    that the robot lacks are dropped. `fps` counts more than the file's. Raises InputError naming `where` and the field.
    """
    joint_pos, body_pos, body_quat = _checked(arrays, where)
    stated = arrays.get("fps")
    if stated is not None and (stated.size != 1 or stated.dtype.kind not in "fiu"):
        raise InputError("not one number", where=f"{where}: fps", got=f"shape {stated.shape}")
    rate, _ = choose_fps(fps, None if stated is None else float(stated.reshape(())), where)
    maker_order = JOINTS_29 if joint_pos.shape[1] == len(JOINTS_29) else JOINTS_23
    clips = {}
    for name, ordered in _ORDERS.items():
        joints = ordered(maker_order)
        kept = [i for i, joint in enumerate(joints) if joint in robot.joint_names or "wrist" not in joint]
        with errors_in(where):
            clip = Clip(
                fps=rate,
                joint_names=tuple(joints[i] for i in kept),
                root_pos_w=body_pos[:, 0],
                root_quat_wxyz=body_quat[:, 0],
                joint_pos_rad=joint_pos[:, kept],
                contact=np.zeros((len(joint_pos), 2)),
                source=Path(where).name,
                license="not stated in the file",
                created_by=f"kata, from an .npz of {len(joints)} joints, {name}",
            )
            clips[_body_error_m(clip, link_names(joints), body_pos, robot)] = clip
    error_m, clip = min(clips.items())
    if error_m > MAX_BODY_ERROR_M:
        got = f"bodies {error_m:.3f} m off in the mean"
        expected = f"the bodies of {robot.name}, {' or '.join(_ORDERS)}"
        raise InputError("joints and bodies do not fit the robot", where=where, got=got, expected=expected)
    return on_the_ground(clip, robot, where)


def _checked(arrays: Mapping[str, np.ndarray], where: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """joint_pos, body_pos_w and body_quat_w with one number of frames and of bodies."""
    shapes = {"joint_pos": 2, "body_pos_w": 3, "body_quat_w": 3}
    for name, dimensions in shapes.items():
        array = arrays.get(name)
        if array is None or array.ndim != dimensions or array.dtype.kind not in "fiu":
            got = "nothing" if array is None else f"shape {array.shape}, type {array.dtype}"
            raise InputError("wrong shape or type", where=f"{where}: {name}", got=got, expected=f"{dimensions} axes")
    joint_pos, body_pos, body_quat = (arrays[name] for name in shapes)
    frames, joints = joint_pos.shape
    check_frames(frames, f"{where}: joint_pos")
    if joints not in (len(JOINTS_29), len(JOINTS_23)):
        raise InputError("wrong number of joints", where=f"{where}: joint_pos", got=joints, expected="29 or 23")
    for name, array, width in (("body_pos_w", body_pos, 3), ("body_quat_w", body_quat, 4)):
        if array.shape != (frames, joints + 1, width):
            expected = (frames, joints + 1, width)
            raise InputError("wrong shape", where=f"{where}: {name}", got=array.shape, expected=expected)
        if not np.isfinite(array).all():
            frame = int(np.argwhere(~np.isfinite(array))[0, 0])
            raise InputError("not finite", where=f"{where}: {name}: frame {frame}", expected="finite numbers")
    return joint_pos, body_pos.astype(np.float64), body_quat.astype(np.float64)


def _body_error_m(clip: Clip, bodies: tuple[str, ...], body_pos_w: np.ndarray, robot: Robot) -> float:
    """Mean distance of the file's `bodies` (their names) from where forward kinematics puts them, over a few frames."""
    frames = np.unique(np.linspace(0, clip.num_frames - 1, CHECKED_FRAMES).astype(int))
    joints = clip.joint_pos_rad[frames][:, robot.joint_index(clip.joint_names)]
    state = robot.kinematics.forward(clip.root_pos_w[frames], clip.root_quat_wxyz[frames], joints)
    shared = [name for name in bodies if name in robot.body_names]
    ours = state.pos_w[:, robot.tracked_index(shared)]
    theirs = body_pos_w[frames][:, [bodies.index(name) for name in shared]]
    return float(np.linalg.norm(ours - theirs, axis=-1).mean())
