"""A balanced robot that falls gives way softly until it has landed, and is damped then."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from deploy.control.bracing import bracing_for
from deploy.control.modes import Mode, Request
from deploy.safety.guard import Guard
from deploy.safety.rules import Fault, make_sample
from hal.contract.types import LinkLost
from tests.deploy.control.test_states import FAST, LEANING, Stage
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, state, with_joint

TICKS = 50  # 1 s


def column(name):
    return ROBOT.joint_names.index(name)


@pytest.fixture
def falling(tmp_path):
    return Stage(tmp_path).bring_to(Mode.BRACING)


@pytest.mark.parametrize("mode", [Mode.READY, Mode.TRACKING, Mode.HOLD])
def test_a_robot_that_an_actor_balances_braces_for_a_second_and_is_damped_then(tmp_path, mode):
    stage = Stage(tmp_path).bring_to(mode)
    results = [stage(reading=LEANING) for _ in range(TICKS + 10)]
    modes = [result.mode for result in results]
    assert modes == [mode] * 2 + [Mode.BRACING] * TICKS + [Mode.DAMPING] * 8
    assert stage.machine.latched and {str(result.fault).split(":")[0] for result in results[2:]} == {"tilt"}
    assert all((result.command is None) == (result.mode is Mode.DAMPING) for result in results)


def test_the_joints_are_sent_to_the_pose_with_a_fifth_of_their_stiffness_and_at_most_half_their_torque(falling):
    """From the default pose: a shoulder at 0.2 may be pulled by 12.5 Nm at 20 Nm/rad, and not to -0.8."""
    command = falling(reading=LEANING).command
    np.testing.assert_allclose(command.kp, 0.2 * ROBOT.kp)
    np.testing.assert_array_equal(command.kd, ROBOT.damping_kd)
    for side in ("left", "right"):
        parts = ("hip_pitch", "knee", "elbow", "shoulder_roll")
        sent = [command.q_rad[column(f"{side}_{part}_joint")] for part in parts]
        assert sent == [-0.4, 0.8, 0.6, 0.2 if side == "left" else -0.2]
        assert command.q_rad[column(f"{side}_shoulder_pitch_joint")] == pytest.approx(0.2 - 12.5 / 20.0)
    assert command.q_rad[column("waist_pitch_joint")] == 0.3


def test_a_joint_that_is_held_elsewhere_is_never_pulled_harder(falling):
    stuck = replace(LEANING, joint_pos_rad=0.9 * ROBOT.pos_upper_rad)
    command = falling(reading=stuck).command
    pulled_nm = np.abs(command.kp * (command.q_rad - stuck.joint_pos_rad))
    assert (pulled_nm <= 0.5 * ROBOT.torque_limit_nm + 1e-9).all() and pulled_nm.max() > 20.0


def test_a_body_that_turns_too_fast_braces_too(tmp_path):
    stage = Stage(tmp_path).bring_to(Mode.TRACKING)
    turning = state(imu_ang_vel_b=np.array([0.0, 7.0, 0.0]))
    assert [stage(reading=turning).mode for _ in range(3)][-1] is Mode.BRACING
    assert stage.machine.fault.rule == "base_rate"


@pytest.mark.parametrize("rule", sorted(set(Guard(ROBOT, SETTINGS, PERIOD_S).counts) - {"tilt", "base_rate"}))
def test_no_other_rule_braces_a_joint_that_runs_away_least_of_all(tmp_path, rule):
    machine = Stage(tmp_path).bring_to(Mode.TRACKING).machine
    machine.trip(Fault(rule, "as the guard says it"))
    assert machine.mode is Mode.DAMPING and machine.advance(LEANING) is None


@pytest.mark.parametrize("mode", [Mode.DAMPING, Mode.STAND_UP, Mode.FIXED_STAND, Mode.LOWERING])
def test_a_robot_that_nobody_balances_is_damped_at_once(tmp_path, mode):
    stage = Stage(tmp_path).bring_to(mode)
    modes = {stage(reading=LEANING).mode for _ in range(10)}
    assert Mode.BRACING not in modes and stage.machine.mode is Mode.DAMPING


@pytest.mark.parametrize(
    "reading",
    [
        LinkLost("silent"),
        state(faults=("overload",)),
        state(imu_age_s=0.2),
        with_joint("joint_pos_rad", np.nan),
        with_joint("joint_vel_rad_s", 200.0),
    ],
    ids=["link", "device", "stale", "nan", "implausible"],
)
def test_whatever_makes_the_pose_unsafe_to_reach_ends_it(falling, reading):
    modes = [falling(reading=reading).mode for _ in range(3)]
    assert modes[-1] is Mode.DAMPING
    assert falling.machine.fault.rule == "tilt"  # the first fault stays the reason


def test_a_loop_that_overruns_ends_it(falling):
    for _ in range(3):
        result = falling.tick(replace(LEANING, time_s=falling.now_s + 1.0), overran=True)
    assert result.mode is Mode.DAMPING


def test_a_body_that_lands_may_break_the_rules_of_one_that_stands(falling):
    """Limits of tilt, base rate, joint speed, range and torque are those of a balanced robot."""
    tumbling = replace(
        LEANING,
        imu_ang_vel_b=np.array([0.0, 15.0, 0.0]),
        joint_vel_rad_s=ROBOT.vel_limit_rad_s * 1.1,
        joint_torque_nm=ROBOT.torque_limit_nm,
        joint_pos_rad=ROBOT.pos_upper_rad + 0.2,
    )
    for _ in range(20):
        assert falling.guard.check(make_sample(tumbling), moving=True, falling=True) is None
    faults = [falling.guard.check(make_sample(tumbling), moving=True) for _ in range(20)]
    assert faults[-1] is not None and faults[-1].rule == "tilt"


def test_an_operator_damps_at_once_and_an_orderly_end_lets_it_land(falling):
    assert falling(Request.FINISH, reading=LEANING).mode is Mode.BRACING
    assert falling(Request.DAMP, reading=LEANING).mode is Mode.DAMPING


def test_another_robot_is_damped_and_a_pose_out_of_reach_is_refused():
    settings = SETTINGS.bracing
    assert bracing_for(ROBOT, None, PERIOD_S) is None
    assert bracing_for(ROBOT, replace(settings, pose_rad={"fin_joint": 0.1}), PERIOD_S) is None
    with pytest.raises(InputError, match="fin_joint"):
        bracing_for(ROBOT, replace(settings, pose_rad=settings.pose_rad | {"fin_joint": 0.1}), PERIOD_S)
    with pytest.raises(InputError, match=r"left_knee_joint.*3\.1"):
        bracing_for(ROBOT, replace(settings, pose_rad=settings.pose_rad | {"left_knee_joint": 3.1}), PERIOD_S)
    for change in ({"stiffness": 0.5}, {"stiffness": 0.0}, {"torque_share": 0.6}, {"lands_s": 2.1}):
        with pytest.raises(InputError, match=next(iter(change))):
            replace(settings, **change)


def test_without_bracing_a_fall_is_damped_at_once(tmp_path):
    stage = Stage(tmp_path, replace(FAST, bracing=None)).bring_to(Mode.TRACKING)
    assert [stage(reading=LEANING).mode for _ in range(3)] == [Mode.TRACKING, Mode.TRACKING, Mode.DAMPING]
