"""Motions of BeyondMimic and mjlab: the order of their joints is found, and everything else about them checked."""

import numpy as np
import pytest

from core.errors import InputError
from motion.importers.g1_joints import JOINTS_23, JOINTS_29, by_depth
from motion.importers.mjlab_npz import read_mjlab
from robot.robot import load_robot
from tests.motion.robot_files import ISAAC_29, mjlab_arrays


def test_isaac_labs_order_is_by_depth():
    assert by_depth(JOINTS_29) == ISAAC_29


@pytest.mark.parametrize(("order", "text"), [
    (JOINTS_29, "29 joints, limb by limb"), (ISAAC_29, "29 joints, by depth"),
    (JOINTS_23, "23 joints, limb by limb"), (by_depth(JOINTS_23), "23 joints, by depth"),
])  # fmt: skip
def test_either_order_is_found(robot, order, text):
    arrays = mjlab_arrays(robot, order)
    clip = read_mjlab(arrays, "folder/dance.npz", robot)
    assert text in clip.created_by and clip.fps == 50.0 and clip.source == "dance.npz" and clip.num_joints == 23
    for name, column in zip(clip.joint_names, clip.joint_pos_rad.T, strict=True):
        np.testing.assert_allclose(column, arrays["joint_pos"][:, order.index(name)])
    np.testing.assert_allclose(clip.root_quat_wxyz[0], [0.8, 0.0, 0.0, 0.6], atol=1e-7)
    np.testing.assert_allclose(clip.root_pos_w[:, :2], [[0.5, 0.2]] * 5, atol=1e-7)


@pytest.mark.parametrize("order", [JOINTS_29, ISAAC_29], ids=["mjlab", "Isaac Lab"])
def test_a_robot_with_wrists_keeps_them(order):
    robot = load_robot("g1_29dof")
    arrays = mjlab_arrays(robot, order)
    clip = read_mjlab(arrays, "a.npz", robot)
    assert clip.joint_names == order
    np.testing.assert_allclose(clip.joint_pos_rad, arrays["joint_pos"], atol=1e-6)


def test_joints_in_another_order_are_refused(robot):
    arrays = mjlab_arrays(robot, tuple(sorted(JOINTS_29)))
    with pytest.raises(InputError, match=r"a\.npz: joints and bodies do not fit the robot, got bodies 0\.\d+ m off"):
        read_mjlab(arrays, "a.npz", robot)


def nan(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[3, 2] = np.nan
    return array


WRONG = {
    "no fps": ({"fps": None}, "frame rate not stated; give it: --fps F"),
    "fps 0": ({"fps": np.array([0])}, "frame rate: out of range, got 0"),
    "fps list": ({"fps": np.array([50, 50])}, "fps: not one number"),
    "no quaternions": ({"body_quat_w": None}, "body_quat_w: wrong shape or type, got nothing"),
    "no axes": ({"joint_pos": np.zeros(5)}, "joint_pos: wrong shape or type"),
    "text": ({"joint_pos": np.full((5, 29), "x")}, "joint_pos: wrong shape or type"),
    "one frame": ({"joint_pos": np.zeros((1, 29))}, "joint_pos: too few frames, got 1"),
    "joints": ({"joint_pos": np.zeros((5, 27))}, "joint_pos: wrong number of joints, got 27, expected 29 or 23"),
    "bodies": (
        {"body_pos_w": np.zeros((5, 27, 3))},
        r"body_pos_w: wrong shape, got \(5, 27, 3\), expected \(5, 30, 3\)",
    ),
    "frames": ({"body_quat_w": np.zeros((4, 30, 4))}, r"body_quat_w: wrong shape, got \(4, 30, 4\)"),
    "nan": ({"body_pos_w": nan(np.zeros((5, 30, 3)))}, "body_pos_w: frame 3: not finite"),
    "nan joint": ({"joint_pos": nan(np.zeros((5, 29)))}, "joint_pos_rad: frame 3: not finite"),
    "degrees": ({"joint_pos": np.full((5, 29), 30.0)}, "joint_pos_rad: frame 0: out of range"),
    "no unit quaternions": ({"body_quat_w": np.zeros((5, 30, 4))}, "root_quat_wxyz: frame 0: out of range"),
}


@pytest.mark.parametrize(("changes", "message"), WRONG.values(), ids=WRONG)
def test_errors_name_file_and_field(robot, changes, message):
    with pytest.raises(InputError, match=rf"^a\.npz: {message}"):
        read_mjlab(mjlab_arrays(robot, **changes), "a.npz", robot)
