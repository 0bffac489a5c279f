"""A clip seen in a mirror: left for right across the plane through the robot's middle."""

from dataclasses import replace

import mujoco
import numpy as np

from core.errors import InputError
from motion.clip import Clip
from motion.reference import joint_columns
from robot.robot import Robot
from world.scene import Box

_ACROSS = np.array([1.0, -1.0, 1.0])
_SAME_AXIS = 1e-3
_SAME_PLACE_M = 2e-3
_SIDES = (("left_", "right_"), ("right_", "left_"))


def mirror_clip(clip: Clip, robot: Robot) -> Clip:
    """The mirror image of `clip` and its scene across the world's x-z plane: y becomes -y, left limbs move as right.

    Joints pair by name (left_*, right_*), others with themselves, and come in the robot's order. Which angles change
    their sign, the model says. Raises InputError when joints do not match or the robot is not its own mirror image.
    """
    partner, sign = joint_mirror(robot)
    joint_pos = clip.joint_pos_rad[:, joint_columns(clip, robot)]
    return replace(
        clip,
        joint_names=robot.joint_names,
        root_pos_w=clip.root_pos_w * _ACROSS,
        root_quat_wxyz=clip.root_quat_wxyz * np.array([1.0, -1.0, 1.0, -1.0]),
        joint_pos_rad=joint_pos[:, partner] * sign,
        contact=clip.contact[:, ::-1],
        scene=replace(clip.scene, boxes=tuple(_mirrored(box) for box in clip.scene.boxes)),
    )


def _mirrored(box: Box) -> Box:
    x, y, z = box.centre_m
    return replace(box, centre_m=(x, 0.0 - y, z), yaw_rad=0.0 - box.yaw_rad)  # no -0.0: a clip's digest tells it from 0


def joint_mirror(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """For every joint, the joint (J,) whose angle it takes in a mirror, and that angle's sign (J,).

    A turn is mirrored to the opposite turn about the mirrored axis: with all joints at 0, an axis that is the mirror
    image of its partner's takes the negative angle, one that points the other way the angle itself. Raises InputError
    naming a joint whose partner is missing, or is not its mirror image.
    """
    partner = np.array([_partner(name, robot) for name in robot.joint_names])
    axis, place = _joints_at_zero(robot)
    mirrored_axis, mirrored_place = axis[partner] * _ACROSS, place[partner] * _ACROSS
    along = (axis * mirrored_axis).sum(axis=1)
    odd = (np.abs(np.abs(along) - 1.0) > _SAME_AXIS) | (np.linalg.norm(place - mirrored_place, axis=1) > _SAME_PLACE_M)
    if odd.any():
        joint = int(np.flatnonzero(odd)[0])
        got = f"{robot.joint_names[joint]} and {robot.joint_names[partner[joint]]}"
        raise InputError("not its own mirror image", where=f"robot {robot.name}", got=got)
    return partner, -np.sign(along)


def _partner(name: str, robot: Robot) -> int:
    for side, other in _SIDES:
        if name.startswith(side):
            name = other + name.removeprefix(side)
            break
    if name not in robot.joint_names:
        raise InputError("no mirror image", where=f"robot {robot.name}", expected=f"a joint {name}")
    return robot.joint_names.index(name)


def _joints_at_zero(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Axes and anchors (J,3) of the joints in the root's frame, all joints at 0."""
    model = robot.model
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    data.qpos[3] = 1.0
    mujoco.mj_kinematics(model, data)
    joints = [model.joint(name).id for name in robot.joint_names]
    return data.xaxis[joints].copy(), data.xanchor[joints].copy()
