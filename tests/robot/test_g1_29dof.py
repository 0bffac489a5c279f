"""The G1 with wrists: the same robot as the one whose forearms are one piece, and the maker's figures."""

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest

from motion.importers.g1_joints import JOINTS_29
from robot.robot import load_robot
from tests.shared_data import SHARED, needs_shared_data

WITH, WITHOUT = load_robot("g1_29dof"), load_robot("g1_23dof")
FOREARM = ("elbow", "wrist_roll", "wrist_pitch", "wrist_yaw")


def posed(robot, joints):
    """Its bodies where the joints of those names have these angles, the others 0."""
    data = mujoco.MjData(robot.model)
    for name, angle in joints.items():
        data.joint(name).qpos = angle
    mujoco.mj_forward(robot.model, data)
    return data


def test_joints_are_in_the_makers_order():
    assert WITH.joint_names == JOINTS_29


def test_with_straight_wrists_it_is_the_robot_of_23_joints():
    """Poses of all bodies that both have, mass and its centre, and the inertia of each forearm about that centre."""
    angles = dict(zip(WITHOUT.joint_names, np.random.default_rng(2).uniform(-0.5, 0.5, 23)))
    ours, theirs = posed(WITH, angles), posed(WITHOUT, angles)
    for name in WITHOUT.body_names:
        np.testing.assert_allclose(ours.body(name).xpos, theirs.body(name).xpos, atol=1e-9)
        np.testing.assert_allclose(ours.body(name).xmat, theirs.body(name).xmat, atol=1e-9)
    assert WITH.model.body_mass.sum() == pytest.approx(WITHOUT.model.body_mass.sum(), abs=1e-5)
    np.testing.assert_allclose(ours.subtree_com[1], theirs.subtree_com[1], atol=1e-7)
    for side in ("left", "right"):
        whole = theirs.body(f"{side}_elbow_link")
        pieces = [f"{side}_{part}_link" for part in FOREARM]
        together = sum(about(WITH, ours, piece, whole.xipos) for piece in pieces)
        alone = about(WITHOUT, theirs, f"{side}_elbow_link", whole.xipos)
        np.testing.assert_allclose(together, alone, atol=1e-7)


def about(robot, data, body, point):
    """Inertia (3, 3) of a body about a point, world axes, by the parallel axis theorem."""
    turn, away = data.body(body).ximat.reshape(3, 3), data.body(body).xipos - point
    own = turn @ np.diag(robot.model.body(body).inertia) @ turn.T
    return own + robot.model.body(body).mass * (away @ away * np.eye(3) - np.outer(away, away))


def test_points_that_motions_track_are_where_they_are_on_the_other():
    angles = np.random.default_rng(3).uniform(-0.5, 0.5, 23)
    wide = np.zeros(29)
    wide[[WITH.joint_names.index(name) for name in WITHOUT.joint_names]] = angles
    root = np.array([0.0, 0.0, 0.8]), np.array([1.0, 0.0, 0.0, 0.0])
    ours, theirs = (robot.kinematics.forward(*root, q).pos_w for robot, q in ((WITH, wide), (WITHOUT, angles)))
    names = [point.name for point in WITHOUT.points]
    np.testing.assert_allclose(ours[WITH.tracked_index(names)], theirs[WITHOUT.tracked_index(names)], atol=1e-6)


def test_gains_are_those_of_a_motor_of_10_hz_and_damping_ratio_2():
    inertia = WITH.model.dof_armature[6:]
    np.testing.assert_allclose(WITH.kp, inertia * (20.0 * np.pi) ** 2, rtol=1e-3)
    np.testing.assert_allclose(WITH.kd, 4.0 * inertia * 20.0 * np.pi, rtol=1e-3)


@needs_shared_data
def test_ranges_limits_and_masses_are_the_makers():
    maker = ElementTree.parse(SHARED / "robot" / "29dof_official.urdf").getroot()
    for i, name in enumerate(WITH.joint_names):
        limit = maker.find(f"joint[@name='{name}']/limit").attrib
        expected = [float(limit[key]) for key in ("lower", "upper", "velocity", "effort")]
        found = [WITH.pos_lower_rad[i], WITH.pos_upper_rad[i], WITH.vel_limit_rad_s[i], WITH.torque_limit_nm[i]]
        assert found == pytest.approx(expected, abs=1e-5), name
    hand_kg = float(maker.find("link[@name='left_rubber_hand']/inertial/mass").get("value"))
    for body in WITH.body_names:
        mass = float(maker.find(f"link[@name='{body}']/inertial/mass").get("value"))
        expected = mass + hand_kg * body.endswith("wrist_yaw_link")
        if "torso" not in body and "pelvis" not in body:  # to which the maker's file fixes further parts
            assert WITH.model.body(body).mass[0] == pytest.approx(expected, abs=1e-5), body
