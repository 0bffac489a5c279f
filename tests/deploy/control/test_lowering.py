"""An orderly end puts a standing robot down; judged by MuJoCo's own pelvis, not by what the loop believes."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.lowering import put_down
from core.errors import InputError
from deploy.control.lowering import Lowering, lowering_for
from deploy.control.modes import Mode, Request
from deploy.control.states import StateMachine
from deploy.safety.rules import Wish
from deploy.settings import CrouchJoint
from tests.deploy.toys import JOINTS, PERIOD_S, ROBOT, SETTINGS, linear_run, state, tilted

POSE = ROBOT.default_pos_rad
TICKS = round((SETTINGS.lowering.down_s + SETTINGS.lowering.settle_s + SETTINGS.lowering.fade_s) / PERIOD_S)
ANKLE = ROBOT.joint_names.index("left_ankle_pitch_joint")


@pytest.mark.parametrize("seed", [0, 1])
def test_the_pelvis_comes_down_slower_than_a_damped_one_and_upright(seed):
    lowered, damped = put_down(seed, Request.FINISH), put_down(seed, Request.QUIT)
    assert lowered.lowest_m < 0.25 and damped.lowest_m < 0.25  # both are down
    assert lowered.fastest_m_s < 0.8 < 1.2 < damped.fastest_m_s
    assert lowered.largest_tilt_rad < 0.45


def lowering():
    return Lowering(ROBOT, POSE, SETTINGS.lowering, PERIOD_S, SETTINGS.blend_s)


def test_targets_move_slowly_from_what_was_sent_to_the_crouch_and_the_gains_end_in_damping():
    down = lowering()
    down.start(Wish(POSE, ROBOT.kp, ROBOT.kd))
    wishes = []
    while not down.done:
        wishes.append(down.wish(state()))
    targets = np.array([wish.target_rad for wish in wishes])
    np.testing.assert_allclose(targets[0], POSE, atol=0.01)
    knee = ROBOT.joint_names.index("left_knee_joint")
    assert targets[-1][knee] == 2.4 and len(wishes) == TICKS
    assert np.abs(np.diff(targets[:, knee])).max() / PERIOD_S < 1.2  # of 2.1 rad in 3 s along a cosine: 1.1 rad/s
    held = round((SETTINGS.lowering.down_s + SETTINGS.lowering.settle_s) / PERIOD_S)
    assert wishes[held].kp[knee] == 300.0 and wishes[held].kp[ANKLE] == 120.0  # 2 x 150, 3 x 40
    assert (wishes[-1].kp < 0.07 * ROBOT.kp).all()
    assert np.abs(wishes[-1].kd - ROBOT.damping_kd).max() < 0.1


def test_the_ankles_press_the_toes_down_where_the_robot_leans_forwards():
    """By 0.7 times the sine of a lean of 0.1 rad; nothing was sent before."""
    down = lowering()
    down.start(None)
    assert down.wish(state(imu_quat_wxyz=tilted(0.1))).target_rad[ANKLE] == pytest.approx(
        POSE[ANKLE] + 0.0699, abs=1e-3
    )


@pytest.mark.parametrize(("lean_rad", "lost"), [(0.30, False), (0.40, True), (-0.40, True)])
def test_a_lean_that_the_ankles_cannot_answer_is_damped(lean_rad, lost, tmp_path):
    machine = standing(tmp_path)
    machine.request(Request.FINISH, state())
    machine.advance(state(imu_quat_wxyz=tilted(lean_rad)))
    assert (machine.mode is Mode.DAMPING) is lost and machine.fault is None and not machine.lowered


def standing(folder):
    stand = linear_run(folder, name="stand")
    machine = StateMachine(ROBOT, stand, [linear_run(folder, name="clip")], SETTINGS, PERIOD_S)
    machine._activate(stand, Mode.READY)
    machine.advance(state())
    return machine


@pytest.mark.parametrize("request_", [Request.FINISH, Request.LOWER])
def test_it_is_lowered_once_and_ends_latched(tmp_path, request_):
    machine = standing(tmp_path)
    for tick in range(TICKS):
        assert machine.request(request_, state()) is None
        wish = machine.advance(state())
        assert machine.mode is Mode.LOWERING and wish.target_rad.size == JOINTS, tick
    assert machine.advance(state()) is None
    assert machine.mode is Mode.DAMPING and machine.latched and machine.fault is None


def test_lowered_is_a_robot_that_came_down_to_the_end_and_was_not_moved_since(tmp_path):
    """Only that one is handed back to its own controller."""
    machine = standing(tmp_path)
    machine.request(Request.FINISH, state())
    for _ in range(TICKS + 1):
        assert not machine.lowered
        machine.advance(state())
    assert machine.lowered
    machine.request(Request.FINISH, state())
    assert machine.lowered


@pytest.mark.parametrize("then", [Request.QUIT, Request.DAMP, Request.ACKNOWLEDGE])
def test_one_that_is_told_something_else_afterwards_is_no_longer_lowered(tmp_path, then):
    machine = standing(tmp_path)
    machine.request(Request.FINISH, state())
    for _ in range(TICKS + 1):
        machine.advance(state())
    machine.request(then, state())
    machine.request(Request.FINISH, state())
    assert not machine.lowered


def test_one_that_was_lowered_though_nobody_asked_for_the_end_is_not_handed_back(tmp_path):
    """Its operator is lost, its motors are hot or its battery is low."""
    machine = standing(tmp_path)
    for _ in range(TICKS + 1):
        machine.request(Request.LOWER, state())
        machine.advance(state())
    assert machine.mode is Mode.DAMPING and not machine.lowered


@pytest.mark.parametrize("request_", [Request.QUIT, Request.DAMP])
def test_while_it_is_lowered_a_stop_damps_at_once(tmp_path, request_):
    machine = standing(tmp_path)
    machine.request(Request.FINISH, state())
    machine.advance(state())
    machine.request(request_, state())
    assert machine.mode is Mode.DAMPING and machine.advance(state()) is None and not machine.lowered


FAST = replace(state(), joint_vel_rad_s=np.full(JOINTS, 2.1))  # nobody takes over at more than 2.0


def performing(folder, wait_s=0.2):
    settings = replace(SETTINGS, lowering=replace(SETTINGS.lowering, wait_s=wait_s))
    stand, clip = linear_run(folder, name="stand"), linear_run(folder, name="clip", seconds=1.0)
    machine = StateMachine(ROBOT, stand, [clip], settings, PERIOD_S)
    machine._activate(stand, Mode.READY)
    machine.request(Request.START, state())
    machine.advance(state())
    assert machine.mode is Mode.TRACKING
    return machine


@pytest.mark.parametrize("rests_after", [3, 70])
def test_an_end_inside_a_motion_waits_until_the_robot_stands_and_lowers_it(tmp_path, rests_after):
    """70 ticks: beyond the end of the clip, whose last pose is held then. It may be asked again and again."""
    machine = performing(tmp_path, wait_s=2.0)
    assert not machine.finishing
    machine.request(Request.FINISH, FAST)
    for tick in range(rests_after):
        assert machine.advance(FAST) is not None and machine.mode in (Mode.TRACKING, Mode.HOLD), tick
        assert machine.request(Request.FINISH, FAST) is None and machine.finishing
    machine.advance(state())
    assert machine.mode is Mode.LOWERING and not machine.finishing
    for _ in range(TICKS + 1):
        machine.advance(state())
    assert machine.mode is Mode.DAMPING and machine.latched and machine.fault is None


def test_one_that_never_stands_is_damped_after_the_wait_and_starts_nothing_meanwhile(tmp_path):
    machine = performing(tmp_path)
    machine.request(Request.FINISH, FAST)
    for _ in range(9):  # of 10 ticks, 0.2 s
        assert machine.advance(FAST) is not None
    machine.mode = Mode.HOLD
    assert machine.request(Request.START, state()) == "start refused: the robot is about to be lowered"
    assert machine.advance(FAST) is None
    assert machine.mode is Mode.DAMPING and machine.latched


@pytest.mark.parametrize("request_", [Request.LOWER, Request.QUIT, Request.DAMP])
def test_inside_a_motion_whatever_does_not_wait_damps_at_once(tmp_path, request_):
    machine = performing(tmp_path)
    machine.request(Request.FINISH, FAST)
    machine.request(request_, state())
    assert machine.mode is Mode.DAMPING and machine.advance(state()) is None


def test_while_it_stands_up_nobody_balances_it_and_it_is_damped(tmp_path):
    machine = standing(tmp_path)
    machine.mode, machine.active = Mode.STAND_UP, None
    machine.request(Request.FINISH, state())
    assert machine.mode is Mode.DAMPING


def test_a_robot_without_the_joints_or_the_setting_is_not_lowered():
    other = replace(SETTINGS.lowering, ankle_pitch_joints=("tail_joint",), ankle_roll_joints=(), crouch={})
    for lowering_settings in (None, other):
        settings = replace(SETTINGS, lowering=lowering_settings)
        assert lowering_for(ROBOT, POSE, settings, PERIOD_S) is None


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"crouch": {"left_kne_joint": CrouchJoint(2.4, 2.0)}},
            "got left_kne_joint, .*did you mean left_knee_joint",
        ),
        ({"ankle_roll_joints": ("tail_joint",)}, "unknown joint, got tail_joint"),
        ({"crouch": {"left_knee_joint": CrouchJoint(24.0, 2.0)}}, r"crouch.left_knee_joint.rad.*24.0.*2.8"),
    ],
)
def test_a_crouch_that_the_robot_cannot_take_is_refused(change, says):
    settings = replace(SETTINGS, lowering=replace(SETTINGS.lowering, **change))
    with pytest.raises(InputError, match=says):
        lowering_for(ROBOT, POSE, settings, PERIOD_S)


def test_without_ankles_nothing_would_balance_it():
    with pytest.raises(InputError, match="ankle_pitch_joints"):
        replace(SETTINGS.lowering, ankle_pitch_joints=())
