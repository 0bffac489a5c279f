"""Standing up: from the measured pose, slowly, waiting for what lags, and what aborts it."""

from dataclasses import replace

import numpy as np
import pytest

from deploy.control.modes import Mode, Request
from tests.deploy.control.test_states import FAST, Stage
from tests.deploy.toys import JOINTS, KNEE, PERIOD_S, ROBOT, state, tilted, with_joint


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("actors")


def test_stand_up_starts_limp_at_the_measured_pose_and_rises_slowly(folder):
    slumped = state(joint_pos_rad=ROBOT.default_pos_rad + 0.4)
    stage = Stage(folder)
    stage(Request.STAND, reading=slumped)
    first = stage.until(Mode.STAND_UP, reading=slumped).command
    np.testing.assert_array_equal(first.kp, np.zeros(JOINTS))
    np.testing.assert_array_equal(first.kd, ROBOT.damping_kd)
    np.testing.assert_array_equal(first.q_rad, slumped.joint_pos_rad)
    targets, gains = [first.q_rad], [first.kp]
    while stage.machine.mode is Mode.STAND_UP and len(targets) < 500:
        followed = state(joint_pos_rad=targets[-1])
        command = stage(reading=followed).command
        targets.append(command.q_rad)
        gains.append(command.kp)
    targets.pop()  # the stand actor's
    speed = np.abs(np.diff(targets, axis=0)).max() / PERIOD_S
    assert 0.7 < speed <= 0.8 + 1e-9
    share = np.array([kp[KNEE] / ROBOT.kp[KNEE] for kp in gains])
    assert share[25] == pytest.approx(0.5, abs=0.01) and share[49] < 1.0 and share[51] == 1.0
    assert (np.diff(share) >= 0).all()
    np.testing.assert_allclose(targets[-1], ROBOT.default_pos_rad, atol=1e-3)


@pytest.mark.parametrize(
    ("bad", "rule"),
    [
        (with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.51), "stand_up_error"),
        (state(imu_quat_wxyz=tilted(0.51)), "stand_up_tilt"),
    ],
)
def test_stand_up_aborts(folder, bad, rule):
    stage = Stage(folder).bring_to(Mode.STAND_UP)
    result = stage(reading=bad)
    assert result.mode is Mode.DAMPING and result.fault.rule == rule and stage.machine.latched
    assert stage.guard.counts[rule] == 1


def test_a_joint_that_lags_is_waited_for_while_the_others_go_on(folder):
    """A shoulder held by hand stands 0.6 rad away: its target goes no farther than 0.25 rad ahead."""
    shoulder = ROBOT.joint_names.index("right_shoulder_pitch_joint")
    held_rad = ROBOT.default_pos_rad[shoulder] - 0.6
    start = state(joint_pos_rad=ROBOT.default_pos_rad - 0.1)
    start.joint_pos_rad[shoulder] = held_rad
    stage = Stage(folder)
    stage(Request.STAND, reading=start)
    result = stage.until(Mode.STAND_UP, reading=start)
    for _ in range(150):
        followed = result.command.q_rad.copy()
        followed[shoulder] = held_rad
        result = stage(reading=state(joint_pos_rad=followed))
    assert result.mode is Mode.STAND_UP
    ahead_rad = result.command.q_rad[shoulder] - held_rad
    assert 0.25 < ahead_rad < 0.27  # a tick beyond the limit, at which it began to wait
    assert ahead_rad * result.command.kp[shoulder] == pytest.approx(25.0)  # as much as its motor may
    others = np.delete(result.command.q_rad - ROBOT.default_pos_rad, shoulder)
    assert np.abs(others).max() < 1e-3
    speeds = []
    while result.mode is Mode.STAND_UP:
        before = result.command.q_rad[shoulder]
        result = stage(reading=state(joint_pos_rad=result.command.q_rad))
        speeds.append((result.command.q_rad[shoulder] - before) / PERIOD_S)
    assert result.mode is Mode.READY and len(speeds) > 20 and max(speeds[:-1]) < 0.8 + 1e-9


def test_a_joint_that_never_comes_is_a_fault_of_that_name(folder):
    behind = with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.26)
    stage = Stage(folder).bring_to(Mode.STAND_UP)
    faults = [stage(reading=behind).fault for _ in range(151)]
    assert faults[:150] == [None] * 150
    assert str(faults[150]) == "stand_up_lag: left_knee_joint is 0.26 rad behind, for 3 s"
    assert stage.guard.counts["stand_up_lag"] == 1


def test_standing_up_begins_when_the_joints_have_come_to_rest(folder):
    stage = Stage(folder)
    stage(Request.STAND)
    for tick in range(100):
        falling = with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.16 * tick)
        assert stage(reading=falling).mode is Mode.DAMPING
    modes = [stage(reading=falling).mode for _ in range(3)]
    assert modes == [Mode.DAMPING, Mode.STAND_UP, Mode.STAND_UP]


def test_joints_that_never_rest_are_a_fault_of_that_name(folder):
    stage = Stage(folder, replace(FAST, stand_up=replace(FAST.stand_up, rest_s=1.0)))
    for tick in range(60):
        swinging = with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.2 * (tick % 2))
        result = stage(*([] if tick else [Request.STAND]), reading=swinging)
        if result.fault:
            break
    assert tick == 50 and str(result.fault) == "not_at_rest: left_knee_joint still moves after 1 s of damping"


def test_stand_up_goes_on_just_inside_its_limits(folder):
    stage = Stage(folder).bring_to(Mode.STAND_UP)
    leaning = with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.49, imu_quat_wxyz=tilted(0.49))
    assert stage(reading=leaning).mode is Mode.STAND_UP
