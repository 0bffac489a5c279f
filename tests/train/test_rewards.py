"""Every reward term on states whose value is worked out by hand."""

import math
from dataclasses import replace

import pytest
import torch

from train.mdp import rewards
from train.mdp.tick import Bodies, ReferenceRows, RobotLimits, StepOutcome
from train.simulation.simulator import PhysicsState

POINTS, JOINTS = 4, 3  # points: pelvis, left foot, right foot, head


def on_reference() -> StepOutcome:
    """One environment that is exactly where its reference is, both feet on the ground."""
    joints, three = torch.zeros(1, JOINTS), torch.zeros(1, POINTS, 3)
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0])
    quats = identity.expand(1, POINTS, 4).clone()
    root, force = torch.zeros(1, 3), torch.tensor([[[0.0, 0.0, 170.0], [0.0, 0.0, 170.0]]])
    physics = PhysicsState(root, identity[None], root, root, joints, joints, joints, force, torch.zeros(1, 2))
    reference = ReferenceRows(
        joints, joints, root, identity[None], root, root, joints, three, quats, three, three,
        torch.ones(1, 2), torch.zeros(1, 1), torch.zeros(1),
    )  # fmt: skip
    limits = RobotLimits(
        pos_lower_rad=torch.full((JOINTS,), -1.0),
        pos_upper_rad=torch.full((JOINTS,), 1.0),
        vel_rad_s=torch.full((JOINTS,), 10.0),
        torque_nm=torch.full((JOINTS,), 20.0),
        default_pos_rad=torch.zeros(JOINTS),
        lower=torch.tensor([0, 1, 2]),
        upper=torch.tensor([3]),
        hands_head=torch.tensor([3]),
        feet=torch.tensor([1, 2]),
    )
    touching = torch.ones(1, 2, dtype=torch.bool)
    return StepOutcome(
        physics=physics,
        bodies=Bodies(three, quats, three, three),
        reference=reference,
        action=joints,
        last_action=joints,
        contact=touching,
        landed=touching,
        first_contact=~touching,
        air_time_s=torch.zeros(1, 2),
        acceleration_error_m=three,
        error_limit_m=1.0,
        ground_m=torch.zeros(1),
        terminated=torch.zeros(1, dtype=torch.bool),
        limits=limits,
    )


def moved(t: StepOutcome, point: int, offset: tuple[float, float, float]) -> StepOutcome:
    pos = t.bodies.pos_w.clone()
    pos[0, point] += torch.tensor(offset)
    return replace(t, bodies=replace(t.bodies, pos_w=pos))


def with_joints(t: StepOutcome, **fields: list[float]) -> StepOutcome:
    return replace(t, physics=replace(t.physics, **{name: torch.tensor([value]) for name, value in fields.items()}))


@pytest.mark.parametrize("name", rewards.TRACKING.names)
def test_no_error_on_the_reference(name):
    assert rewards.TRACKING[name](on_reference()).tolist() == [0.0]


@pytest.mark.parametrize("name", rewards.DIRECT.names)
def test_no_penalty_on_the_reference(name):
    assert rewards.DIRECT[name](on_reference()).tolist() == [1.0 if name == "contact_mask" else 0.0]


def value(term, t: StepOutcome) -> float:
    return term(t)[0].item()


def test_position_errors_are_means_of_squares_over_points_and_components():
    head_off = moved(on_reference(), 3, (0.3, 0.0, 0.4))
    assert value(rewards.body_position_upper, head_off) == pytest.approx(0.25 / 3)
    assert value(rewards.hands_head, head_off) == pytest.approx(0.25 / 3)
    assert value(rewards.body_position_lower, head_off) == 0.0
    foot_off = moved(on_reference(), 1, (0.0, 0.3, 0.0))
    assert value(rewards.body_position_lower, foot_off) == pytest.approx(0.09 / 9)
    assert value(rewards.feet, foot_off) == pytest.approx(0.09 / 6)


def test_relative_positions_do_not_see_where_the_pelvis_is():
    """Points are pelvis, two feet, head: all moved together is no error; the pelvis alone moves the other three."""
    all_off = on_reference()
    for point in range(4):
        all_off = moved(all_off, point, (0.3, 0.0, 0.4))
    assert value(rewards.body_position_relative, all_off) == pytest.approx(0.0, abs=1e-12)
    assert value(rewards.body_position_relative, moved(on_reference(), 0, (0.3, 0.0, 0.4))) == pytest.approx(
        3 * 0.25 / 12
    )
    assert value(rewards.body_position_relative, moved(on_reference(), 3, (0.0, 0.6, 0.0))) == pytest.approx(0.36 / 12)


def test_body_acceleration_is_the_mean_length_over_the_points():
    """Pelvis and head are off by 0.2 and 0.5 m/step², the feet are not: 0.7 over four points."""
    error_m = torch.zeros(1, POINTS, 3)
    error_m[0, 0, 1], error_m[0, 3] = -0.2, torch.tensor([0.3, 0.0, 0.4])
    assert value(rewards.body_acceleration, replace(on_reference(), acceleration_error_m=error_m)) == pytest.approx(
        0.7 / 4
    )


def test_joint_errors():
    t = with_joints(on_reference(), joint_pos_rad=[0.3, -0.6, 0.0], joint_vel_rad_s=[1.0, 2.0, 2.0])
    assert value(rewards.joint_position, t) == pytest.approx((0.09 + 0.36) / 3)
    assert value(rewards.joint_velocity, t) == pytest.approx(3.0)
    assert value(rewards.max_joint, t) == pytest.approx(0.6)


def test_body_rotation_ignores_the_sign_of_quaternions():
    t = on_reference()
    half = math.radians(30) / 2
    quats = t.bodies.quat_wxyz.clone()
    quats[0, 0] = torch.tensor([math.cos(half), math.sin(half), 0.0, 0.0])
    # |q - q̂|² / 4 of one of four points: ((1 - cos)² + sin²) / 4 / 4
    expected = ((1 - math.cos(half)) ** 2 + math.sin(half) ** 2) / 4 / POINTS
    turned = replace(t, bodies=replace(t.bodies, quat_wxyz=quats))
    flipped = replace(t, bodies=replace(t.bodies, quat_wxyz=-quats))
    assert value(rewards.body_rotation, turned) == pytest.approx(expected, rel=1e-4)
    assert value(rewards.body_rotation, flipped) == pytest.approx(expected, rel=1e-4)


def test_heading_is_the_turn_of_the_first_body_about_the_vertical():
    """From 170° to -175° is 15°; leaning forward turns nothing."""
    wanted, actual, lean = math.radians(170) / 2, math.radians(-175) / 2, math.radians(40) / 2
    t = on_reference()
    quats, reference = t.bodies.quat_wxyz.clone(), t.reference.body_quat_wxyz.clone()
    reference[0, 0] = torch.tensor([math.cos(wanted), 0.0, 0.0, math.sin(wanted)])
    # Rotation by the heading after the lean about y: q_z · q_y.
    c, s = math.cos(actual), math.sin(actual)
    quats[0, 0] = torch.tensor([c * math.cos(lean), -s * math.sin(lean), c * math.sin(lean), s * math.cos(lean)])
    quats[0, 1] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    turned = replace(
        t, bodies=replace(t.bodies, quat_wxyz=quats), reference=replace(t.reference, body_quat_wxyz=reference)
    )
    assert value(rewards.heading, turned) == pytest.approx(math.radians(15) ** 2, rel=1e-4)


def test_body_velocities():
    t = on_reference()
    fast = torch.zeros(1, POINTS, 3)
    fast[0, 2] = torch.tensor([3.0, 0.0, 4.0])
    assert value(rewards.body_velocity, replace(t, bodies=replace(t.bodies, lin_vel_w=fast))) == pytest.approx(25 / 12)
    assert value(rewards.body_angular_velocity, replace(t, bodies=replace(t.bodies, ang_vel_w=fast))) == pytest.approx(
        25 / 12
    )


def test_contact_mask_counts_feet_that_disagree():
    t = replace(on_reference(), contact=torch.tensor([[True, False]]))
    assert value(rewards.contact_mask, t) == 0.5


def test_limits():
    speeds, torques = [10.4, -15.0, 0.0], [25.0, -20.3, 20.0]
    t = with_joints(on_reference(), joint_pos_rad=[1.2, -1.1, 0.0], joint_vel_rad_s=speeds, torque_nm=torques)
    assert value(rewards.joint_position_limits, t) == pytest.approx(0.3, rel=1e-5)
    assert value(rewards.joint_velocity_limits, t) == pytest.approx(0.4 + 1.0, rel=1e-5)
    assert value(rewards.torque_limits, t) == pytest.approx(1.0 + 0.3, rel=1e-5)
    assert value(rewards.joint_position_limits_indicator, t) == 1.0
    assert value(rewards.joint_velocity_limits_indicator, t) == 1.0
    assert value(rewards.torque_limits_indicator, t) == 1.0
    assert value(rewards.torque, t) == pytest.approx(25.0**2 + 20.3**2 + 20.0**2)


def test_feet():
    t = on_reference()
    speed = torch.zeros(1, POINTS, 3)
    speed[0, 1], speed[0, 2] = torch.tensor([2.0, 3.0, 6.0]), torch.tensor([0.0, 2.0, 0.0])
    sliding = replace(t, bodies=replace(t.bodies, lin_vel_w=speed), contact=torch.tensor([[True, False]]))
    assert value(rewards.slippage, sliding) == 7.0  # all three axes in the code,
    assert value(rewards.slippage_squared, sliding) == 13.0  # the horizontal ones in the paper
    landing = replace(t, first_contact=torch.tensor([[True, False]]), air_time_s=torch.tensor([[0.5, 0.4]]))
    assert value(rewards.feet_air_time, landing) == pytest.approx(0.2)
    assert value(rewards.feet_air_time_indicator, landing) == 2.0


@pytest.mark.parametrize(("force", "stumbles"), [((60.0, 0.0, 10.0), 1.0), ((40.0, 0.0, 10.0), 0.0)])
def test_stumble(force, stumbles):
    t = on_reference()
    forces = t.physics.foot_force_w.clone()
    forces[0, 0] = torch.tensor(force)
    assert value(rewards.stumble, replace(t, physics=replace(t.physics, foot_force_w=forces))) == stumbles


def test_contact_force_and_collision():
    t = on_reference()
    forces = torch.tensor([[[300.0, 0.0, 400.0], [0.0, 0.0, 390.0]]])
    hit = replace(t.physics, foot_force_w=forces, body_force_n=torch.tensor([[0.2, 0.05]]))
    assert value(rewards.feet_contact_force, replace(t, physics=hit)) == pytest.approx(100.0)
    assert value(rewards.collision, replace(t, physics=hit)) == 1.0


def test_action_rate_and_termination():
    t = replace(on_reference(), action=torch.tensor([[1.0, 0.0, -2.0]]), terminated=torch.tensor([True]))
    assert value(rewards.action_rate, t) == 5.0
    assert value(rewards.termination, t) == 1.0
