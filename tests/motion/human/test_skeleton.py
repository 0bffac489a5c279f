"""The mean skeleton against scipy's rotations and figures of people."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.rotations import quat_rotate
from motion.human.motion import ANKLES, JOINTS
from motion.human.skeleton import FEET, FROM_SMPL_WXYZ, MEAN_SKELETON, posed, soles_w
from tests.motion.human.people import person


def test_the_t_pose_is_that_of_a_person():
    """It faces +x, the left arm along +y, the head along +z; about 1.7 m tall: the top of the head is 0.2 above
    the joint of the head."""
    place = dict(zip(JOINTS, MEAN_SKELETON.t_pose_m(), strict=True))
    ground = place["left_ankle"][2] + MEAN_SKELETON.sole_m[0, 0, 2]
    assert 1.45 < place["head"][2] - ground < 1.55
    assert place["left_wrist"][1] > 0.6 and place["left_foot"][0] > place["left_ankle"][0] + 0.1
    assert place["pelvis"][2] - ground == pytest.approx(0.938, abs=1e-3)
    for joint in ("hip", "ankle", "wrist", "foot"):
        np.testing.assert_allclose(place[f"right_{joint}"], place[f"left_{joint}"] * [1, -1, 1], atol=1e-12)


def test_smpl_axes():
    """SMPL: x left, y up, z forward."""
    turned = quat_rotate(np.tile(FROM_SMPL_WXYZ, (3, 1)), np.eye(3))
    np.testing.assert_allclose(turned, [[0, 1, 0], [0, 0, 1], [1, 0, 0]], atol=1e-12)


def test_forward_kinematics():
    who = person(bend_rad=1.5)
    local = np.array([[turn.as_quat() for turn in frame] for frame in who.local])[..., [3, 0, 1, 2]]
    pos, quat = posed(MEAN_SKELETON, who.root, local)
    np.testing.assert_allclose(pos, who.places(), atol=1e-9)
    true = np.array([[turn.as_quat() for turn in turns] for turns in who.segments()])[..., [3, 0, 1, 2]]
    np.testing.assert_allclose(np.abs((quat * true).sum(axis=-1)), 1.0, atol=1e-9)


def test_soles_turn_with_ankle_and_toes():
    """The left ankle 90 degrees about y (toes down) and its foot joint back: the toe points ahead, the heel is up."""
    local = [[Rotation.identity()] * len(JOINTS)]
    local[0] = [*local[0]]
    local[0][ANKLES[0]] = Rotation.from_euler("y", 90, degrees=True)
    local[0][FEET[0]] = Rotation.from_euler("y", -90, degrees=True)
    quat = np.array([[turn.as_quat() for turn in frame] for frame in local])[..., [3, 0, 1, 2]]
    pos, quat = posed(MEAN_SKELETON, np.zeros((1, 3)), quat)
    t_pose = MEAN_SKELETON.t_pose_m()
    foot = t_pose[list(FEET)] - t_pose[list(ANKLES)]
    sole = soles_w(MEAN_SKELETON.sole_m, foot, pos, quat)
    heel, ball, _, toe = sole[0, 0] - pos[0, ANKLES[0]]
    np.testing.assert_allclose(heel, [-0.070, 0.010, 0.055], atol=1e-9)
    np.testing.assert_allclose(ball, [-0.070, -0.015, -0.121], atol=1e-9)
    ankle_to_foot = [-0.0520, 0.0259, -0.1213]
    np.testing.assert_allclose(toe, np.add(ankle_to_foot, MEAN_SKELETON.sole_m[0, 3] - foot[0]), atol=1e-9)
    flat = sole[0, 1] - pos[0, ANKLES[1]]
    np.testing.assert_allclose(flat, MEAN_SKELETON.sole_m[1], atol=1e-9)
