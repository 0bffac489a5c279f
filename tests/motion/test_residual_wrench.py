"""The wrench that the ground cannot supply, and the friction that a clip needs, against values by hand."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from motion.inverse_dynamics import ground_force_map
from motion.library import bundled_names, open_motion
from motion.reference import build_reference
from motion.residual_wrench import (
    Residual,
    ResidualSettings,
    bearing_feet,
    demand_of,
    friction_needed,
    residual_wrench,
    unsupplied,
)
from tests.shared_data import SHARED, needs_shared_data

G = 9.81
FPS = 50.0
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def mass_kg(robot):
    return float(robot.model.body_mass.sum())


@pytest.fixture
def demanded(standing_clip, robot):
    """The demand of the default pose moved along a way (N,3), m, from where the soles touch the ground."""
    root = [0.0, 0.0, -lowest_sole(robot, UPRIGHT, robot.default_pos_rad)[2]]

    def build(way_m, **changes):
        clip = standing_clip(len(way_m), FPS, root_pos_w=root + way_m, **changes)
        return demand_of(robot, build_reference(clip, robot))

    return build


def still(num_frames=151):
    return np.zeros((num_frames, 3))


def seconds(num_frames=151):
    return np.arange(num_frames) / FPS


def inner(values):
    """Without the first and last half second, where accelerations are smoothed against the clip's ends."""
    return values[1:-1]


def test_standing_needs_nothing(demanded):
    demand = demanded(still())
    left = residual_wrench(demand)
    assert left.force_n.max() < 1e-3 and left.torque_nm.max() < 1e-3
    assert "can supply the whole motion" in str(left)
    assert friction_needed([demand]) < 0.01


@pytest.mark.parametrize("acceleration", [0.5, 1.0, 1.5])
def test_accelerating_sideways_needs_a_over_g(demanded, robot, mass_kg, acceleration):
    way = still()
    way[:, 1] = 0.5 * acceleration * seconds() ** 2
    demand = demanded(way)
    assert inner(residual_wrench(demand).force_n).max() < 1e-3
    assert friction_needed([demand]) == pytest.approx(acceleration / G, abs=0.005 + 1.0 / (mass_kg * G))
    without = residual_wrench(demand, friction=0.0)
    assert inner(without.force_n) == pytest.approx(mass_kg * acceleration, rel=1e-3)
    ahead_m = abs(com_w(robot, UPRIGHT, robot.default_pos_rad)[0])  # of the root: without friction nothing turns it
    assert inner(without.torque_nm) == pytest.approx(mass_kg * acceleration * ahead_m, rel=1e-3)


@pytest.mark.parametrize(("share", "acceleration"), [(0.5, 0.5), (0.75, 1.0), (1.0, 1.5)])
def test_a_share_of_the_half_seconds_needs_no_more_than_the_easiest_of_them(share, acceleration, demanded, mass_kg):
    """A quarter each stands, and is accelerated by 0.5, 1.0 and 1.5 m/s². The last is accelerated least at its ends."""
    ways = [0.5 * a * seconds()[:, None] ** 2 * np.array([0.0, 1.0, 0.0]) for a in (0.0, 0.5, 1.0, 1.5)]
    needed = friction_needed([demanded(way) for way in ways], share)
    assert needed == pytest.approx(acceleration / G, abs=0.005 + 1.0 / (mass_kg * G))


def test_along_the_diagonal_the_pyramid_finds_root_two_of_it(demanded, mass_kg):
    way = still()
    way[:, :2] = 0.25 * seconds()[:, None] ** 2  # 0.5 m/s² along x and along y
    assert friction_needed([demanded(way)]) == pytest.approx(1.0 / G, abs=0.005 + 2.0 / (mass_kg * G))


def test_leaning_over_the_toes_leaves_the_moment_of_the_weight(standing_clip, robot, mass_kg):
    """A rigid lean about the ankles on flat feet: about the toes' edge the residual has the moment m g d."""
    lean_rad = 0.3
    joints = robot.default_pos_rad.copy()
    ankles = [robot.joint_names.index(f"{side}_ankle_pitch_joint") for side in ("left", "right")]
    joints[ankles] -= lean_rad
    quat = np.array([np.cos(lean_rad / 2), 0.0, np.sin(lean_rad / 2), 0.0])
    height = -lowest_sole(robot, quat, joints)[2]
    clip = standing_clip(
        51, FPS, root_pos_w=np.tile([0.0, 0.0, height], (51, 1)), root_quat_wxyz=np.tile(quat, (51, 1)),
        joint_pos_rad=np.tile(joints, (51, 1)),
    )  # fmt: skip
    toes_x = max(sole_points(robot, quat, joints)[:, 0])
    outside_m = com_w(robot, quat, joints)[0] - toes_x
    assert 0.02 < outside_m < 0.1
    weight_moment = mass_kg * G * outside_m
    demand = demand_of(robot, build_reference(clip, robot))
    left = unsupplied(demand, 0.7)[25]
    assert abs(left[4] + height * left[0] + toes_x * left[2]) == pytest.approx(weight_moment, rel=1e-3)
    square = height**2 + toes_x**2
    found = residual_wrench(demand)
    assert found.torque_nm == pytest.approx(weight_moment / (1 + square), rel=1e-3)
    assert found.force_n == pytest.approx(weight_moment * np.sqrt(square) / (1 + square), rel=1e-3)


def posed(robot, quat, joints):
    """MuJoCo's data with the root at the origin."""
    model = robot.model
    data = mujoco.MjData(model)
    data.qpos[:] = [0.0, 0.0, 0.0, *quat, *joints]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def com_w(robot, quat, joints):
    return posed(robot, quat, joints).subtree_com[0]


def sole_points(robot, quat, joints):
    """World positions of all sole points with the root at the origin, by MuJoCo."""
    data = posed(robot, quat, joints)
    feet = [(data.body(foot), robot.sole_points_m[foot]) for foot in robot.feet]
    return np.concatenate([body.xpos + points @ body.xmat.reshape(3, 3).T for body, points in feet])


def lowest_sole(robot, quat, joints):
    points = sole_points(robot, quat, joints)
    return points[points[:, 2].argmin()]


def test_free_fall_needs_no_ground_and_hanging_in_the_air_all_of_the_weight(demanded, mass_kg):
    fall = still()
    fall[:, 2] = 20.0 - 0.5 * G * seconds() ** 2
    air = np.zeros((151, 2))
    falling = residual_wrench(demanded(fall, contact=air))
    assert inner(falling.force_n).max() < 1e-3 and inner(falling.torque_nm).max() < 1e-3
    hanging = residual_wrench(demanded(still() + np.array([0.0, 0.0, 1.0]), contact=air))
    assert hanging.force_n == pytest.approx(mass_kg * G, rel=1e-6)


def test_who_bears(standing_clip, robot):
    def bears(lift_m, contact):
        clip = standing_clip(2, contact=np.tile(contact, (2, 1)), root_pos_w=np.tile([0, 0, lift_m], (2, 1)))
        return bearing_feet(robot, build_reference(clip, robot))[0].tolist()

    ground = -lowest_sole(robot, UPRIGHT, robot.default_pos_rad)[2]
    assert bears(ground, [1.0, 0.0]) == [True, False]
    assert bears(ground, [0.5, 0.4]) == [True, False]
    assert bears(ground + 0.015, [0.0, 0.0]) == [True, True]
    assert bears(ground + 0.025, [0.0, 0.0]) == [False, False]


def test_weak_joints_leave_what_a_bounded_least_squares_leaves(demanded, robot):
    """Against scipy's solver for bounded forces and bounded joint torques, each a variable of its own."""
    demand = demanded(still(3))
    weak = replace(demand, torque_limit_nm=0.05 * robot.torque_limit_nm)
    left = unsupplied(weak, 0.7)[1]
    assert np.linalg.norm(left) > 5.0 > 1e-3 > np.linalg.norm(unsupplied(demand, 0.7)[1])
    push = ground_force_map(demand.jacobians[1], 0.7)
    joints, forces = len(robot.joint_names), push.shape[1]
    carrying = push[6:].any(axis=1)
    weight = np.concatenate([np.ones(6), np.where(carrying, 1e4, 0.0)])
    torques = np.vstack([np.zeros((6, joints)), np.eye(joints)])
    limit = np.where(carrying, weak.torque_limit_nm, 1e3)
    bounds = np.append(np.zeros(forces), -limit), np.append(np.full(forces, np.inf), limit)
    system = weight[:, None] * np.hstack([push, torques])
    solved = lsq_linear(system, weight * demand.wanted[1], bounds, method="bvls", max_iter=1000)
    expected = demand.wanted[1, :6] - push[:6] @ solved.x[:forces]
    assert np.linalg.norm(left) == pytest.approx(np.linalg.norm(expected), rel=1e-3)


def test_half_seconds(demanded):
    left = residual_wrench(demanded(still(66)))  # 1.3 s
    assert left.start_s == pytest.approx([0.0, 0.5]) and left.end_s == pytest.approx([0.5, 1.3])
    short = residual_wrench(demanded(still(3)))
    assert short.start_s == pytest.approx([0.0]) and short.end_s == pytest.approx([0.04])


def test_impossible_spans_join_and_the_worst_is_named():
    starts = np.arange(5) * 0.5
    left = Residual(starts, starts + 0.5, np.array([0, 21, 3, 0, 0.0]), np.array([0, 0, 30.0, 0, 25]))
    assert left.impossible_spans_s(ResidualSettings(20.0, 20.0)) == [(0.5, 1.5), (2.0, 2.5)]
    assert left.impossible_spans_s(ResidualSettings(40.0, 40.0)) == []
    assert str(left) == "the ground cannot supply 30.0 Nm and 3.0 N on the root (worst half second, from 1.0 s)"


@pytest.mark.parametrize("name", bundled_names())
def test_of_the_bundled_clips_nothing_is_left(name, robot):
    left = residual_wrench(demand_of(robot, build_reference(open_motion(name, robot), robot)))
    assert left.torque_nm.max() < 0.05 and left.force_n.max() < 0.05


@needs_shared_data
@pytest.mark.parametrize(
    ("name", "torque_nm", "start_s"),
    [("Charleston_dance", 26.0, 18.5), ("Roundhouse_kick", 40.0, 1.5), ("Horse-stance_pose", 14.6, 4.0)],
)
def test_real_clips(name, torque_nm, start_s, robot):
    clip = open_motion(str(SHARED / "pbhc" / f"{name}.pkl"), robot)
    left = residual_wrench(demand_of(robot, build_reference(clip, robot)))
    assert left.torque_nm[left.worst] == pytest.approx(torque_nm, abs=0.6)
    assert left.start_s[left.worst] == pytest.approx(start_s)
