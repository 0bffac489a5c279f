"""Every way between the states, and the ways that do not exist."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from deploy.control.modes import ALLOWED, Mode, Request
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.safety.guard import Guard
from hal.contract.types import LinkLost, RobotState
from tests.deploy.toys import (
    GRAVITY_Z,
    JOINTS,
    KNEE,
    PERIOD_S,
    PHASE,
    ROBOT,
    SETTINGS,
    linear_run,
    state,
    tilted,
    with_joint,
)

FAST = replace(
    SETTINGS,
    stand_up=replace(SETTINGS.stand_up, damping_s=0.04),
    blend_s=0.1,
)

LEANING = state(imu_quat_wxyz=tilted(0.8))


class Stage:
    """A machine between its tick and a robot that does nothing by itself. With a second a tick, no change is sudden."""

    def __init__(self, folder, settings=FAST, *, stand=None, tracked=None):
        self.stand = stand or linear_run(folder, name="stand")
        self.tracked = tracked or [linear_run(folder, {(GRAVITY_Z, "left_knee_joint"): -0.1}, name="clip", seconds=0.2)]
        self.machine = StateMachine(ROBOT, self.stand, self.tracked, settings, PERIOD_S)
        self.guard = Guard(ROBOT, settings, PERIOD_S)
        self.tick = Tick(self.machine, self.guard)
        self.now_s = 0.0

    def __call__(self, *requests, reading=None):
        self.now_s += 1.0
        reading = state() if reading is None else reading
        return self.tick(replace(reading, time_s=self.now_s) if isinstance(reading, RobotState) else reading, requests)

    def until(self, mode, at_most=200, reading=None):
        for _ in range(at_most):
            result = self(reading=reading)
            if result.mode is mode:
                return result
        raise AssertionError(f"stayed in {self.machine.mode}")

    def fall(self):
        """Lean until a rule says so."""
        for _ in range(10):
            if self(reading=LEANING).mode is not Mode.TRACKING:
                return
        raise AssertionError("it never fell")

    def bring_to(self, mode):
        """To any state the way an operator would."""
        self.machine._fixed_stand = mode is Mode.FIXED_STAND
        if mode is Mode.IDLE:
            return self
        self(Request.STAND)
        if mode is Mode.DAMPING:
            return self
        self.until(Mode.STAND_UP)
        if mode is Mode.STAND_UP:
            return self
        if mode is Mode.FIXED_STAND:
            self.until(mode)
            return self
        self.until(Mode.READY)
        if mode in (Mode.READY, Mode.LOWERING):
            if mode is Mode.LOWERING:
                self(Request.FINISH)
            return self
        self(Request.START)
        if mode is Mode.BRACING:
            self.fall()
        if mode is Mode.HOLD:
            self.until(Mode.HOLD)
        return self


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("actors")


def test_the_whole_way(folder):
    stage = Stage(folder)
    seen = [stage().mode]
    modes = list(stage(Request.STAND).modes)
    for _ in range(200):
        modes += stage().modes
        if stage.machine.mode is Mode.READY:
            break
    modes += stage(Request.START).modes
    for _ in range(30):
        modes += stage().modes
    assert seen == [Mode.IDLE]
    assert modes == [Mode.DAMPING, Mode.STAND_UP, Mode.READY, Mode.TRACKING, Mode.HOLD]
    assert stage.machine.active is stage.stand


def test_nothing_is_sent_in_idle_and_nothing_but_damping_in_damping(folder):
    stage = Stage(folder)
    assert stage().command is None
    assert stage(Request.STAND).command is None


def test_standing_up_waits_until_the_devices_obey_and_begins_where_the_joints_are_then(folder):
    """The robot goes limp while its motion service lets go: the pose of before is no longer its own."""
    stage = Stage(folder)
    limp = with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.3)
    stage(Request.STAND, reading=replace(state(), energised=False))
    for _ in range(250):
        assert stage(reading=replace(state(), energised=False)).mode is Mode.DAMPING
    waits = [stage(reading=limp).mode for _ in range(2)]
    first = stage(reading=limp)
    assert waits == [Mode.DAMPING] * 2 and first.mode is Mode.STAND_UP
    np.testing.assert_array_equal(first.command.kp, 0.0)
    np.testing.assert_array_equal(first.command.q_rad, limp.joint_pos_rad)


def test_devices_that_never_obey_are_a_fault_of_that_name(folder):
    stage = Stage(folder, replace(FAST, stand_up=replace(FAST.stand_up, energise_s=1.0)))
    deaf = replace(state(), energised=False)
    stage(Request.STAND, reading=deaf)
    modes = [stage(reading=deaf).fault for _ in range(50)]
    assert modes[:49] == [None] * 49
    assert str(modes[49]) == "not_energised: no device obeys 1 s after the first command"
    assert stage.guard.counts["not_energised"] == 1 and stage.machine.latched


@pytest.mark.parametrize(("mode", "request_"), list(itertools.product(Mode, Request)), ids=lambda value: value.name)
def test_every_request_in_every_state(folder, mode, request_):
    """What is not in the table changes nothing and says why."""
    ends = dict.fromkeys(Mode, Mode.DAMPING) | {Mode.IDLE: Mode.IDLE}
    lands = {Mode.BRACING: Mode.BRACING}
    lowers = dict.fromkeys((Mode.READY, Mode.HOLD, Mode.LOWERING), Mode.LOWERING)
    expected = {
        Request.STAND: {Mode.IDLE: Mode.DAMPING, Mode.FIXED_STAND: Mode.READY},
        Request.START: {Mode.READY: Mode.TRACKING, Mode.HOLD: Mode.TRACKING},
        Request.DAMP: dict.fromkeys(Mode, Mode.DAMPING),
        Request.LOWER: ends | lowers | lands,
        Request.FINISH: ends | lowers | lands | {Mode.TRACKING: Mode.LOWERING},
        Request.QUIT: ends,
        Request.HOLD: {Mode.TRACKING: Mode.HOLD},
        Request.SWITCH: {m: m for m in Mode if m is not Mode.DAMPING},
        Request.ACKNOWLEDGE: {m: m for m in (Mode.IDLE, Mode.DAMPING)},
    }[request_]
    stage = Stage(folder).bring_to(mode)
    assert stage.machine.mode is mode
    result = stage(request_)
    if mode in expected:
        assert mode in ALLOWED[request_]
        assert result.refused == () and not result.finishing
        assert result.mode is expected[mode]
    else:
        assert result.mode is mode
        assert request_.value in result.refused[0] and mode.name in result.refused[0]


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("why", ["damp", "quit", "fault", "link"])
def test_stop_and_fault_damp_and_latch_in_every_state_on_the_same_tick(folder, mode, why):
    if mode is Mode.IDLE and why != "damp":
        pytest.skip("nothing is in force that would have to end")
    stage = Stage(folder).bring_to(mode)
    if why == "fault":
        result = stage(reading=state(faults=("overload",)))
    elif why == "link":
        result = stage(reading=LinkLost("silent"))
    else:
        result = stage(Request(why))
    assert result.mode is Mode.DAMPING and result.command is None and stage.machine.latched
    assert (result.fault is None) == (why in ("damp", "quit") and mode is not Mode.BRACING)
    for _ in range(100):
        assert stage().mode is Mode.DAMPING
    assert stage(Request.STAND).mode is Mode.DAMPING


def test_acknowledge_leads_to_idle_never_straight_up(folder):
    stage = Stage(folder).bring_to(Mode.TRACKING)
    stage(reading=state(faults=("overload",)))
    assert stage(Request.ACKNOWLEDGE).acknowledged
    result = stage()
    assert result.mode is Mode.IDLE and result.fault is None
    assert stage(Request.START, Request.HOLD).mode is Mode.IDLE
    assert stage(Request.STAND).mode is Mode.DAMPING


def test_the_first_fault_stays_the_reason(folder):
    stage = Stage(folder).bring_to(Mode.READY)
    stage(reading=state(faults=("overload",)))
    assert stage(reading=LinkLost("silent")).fault.rule == "device_fault"


OUTSIDE = [
    with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.151),
    with_joint("joint_vel_rad_s", -2.01),
    state(imu_quat_wxyz=tilted(0.101)),
    state(imu_ang_vel_b=np.array([0.0, 0.22, 0.22])),
]


@pytest.mark.parametrize("outside", OUTSIDE)
def test_no_hand_over_outside_the_entry_conditions(folder, outside):
    stage = Stage(folder).bring_to(Mode.STAND_UP)
    for _ in range(200):
        assert stage(reading=outside).mode is Mode.STAND_UP
    stage.until(Mode.READY)
    refused = stage(Request.START, reading=outside)
    assert refused.mode is Mode.READY and refused.refused[0].startswith("start refused: ")
    assert refused.actor is stage.stand and refused.command is not None
    assert stage(Request.START).mode is Mode.TRACKING


@pytest.mark.parametrize("outside", OUTSIDE)
def test_after_the_clip_its_actor_goes_on_at_phase_one_until_standing_can_take_over(folder, outside):
    phase_to_knee = linear_run(folder, {(PHASE, "left_knee_joint"): 0.1}, name="phase", seconds=0.2)
    stage = Stage(folder, tracked=[phase_to_knee]).bring_to(Mode.TRACKING)
    stage.until(Mode.HOLD, reading=outside)
    for _ in range(20):
        result = stage(reading=outside)
        assert result.mode is Mode.HOLD and result.actor is phase_to_knee
        assert result.output.target_rad[KNEE] == pytest.approx(ROBOT.default_pos_rad[KNEE] + 0.1, abs=1e-6)
    assert stage().actor is stage.stand


def test_phase_at_tick_k_and_the_number_of_ticks(folder):
    """31 frames at 50 fps: 0.6 s, 30 ticks, phase k / 30."""
    run = linear_run(folder, {(PHASE, "left_knee_joint"): 0.1}, name="phase30", seconds=0.6)
    assert run.num_ticks == 30
    stage = Stage(folder, tracked=[run]).bring_to(Mode.READY)
    results = [stage(Request.START)]
    while stage.machine.mode is Mode.TRACKING:
        results.append(stage())
    asked = [result.output.target_rad[KNEE] - ROBOT.default_pos_rad[KNEE] for result in results[:30]]
    np.testing.assert_allclose(asked, 0.1 * np.arange(30) / 30, atol=1e-6)
    assert len(results) == 31 and results[30].mode is Mode.HOLD


def test_targets_and_gains_blend_from_what_was_last_sent(folder):
    """5 ticks of 0.02 s make 0.1 s: a fifth of the way each."""
    stage = Stage(folder).bring_to(Mode.READY)
    for _ in range(10):
        before = stage().command
    step = -0.1 * -1.0  # weight times projected gravity's z
    after = [stage(Request.START).command] + [stage().command for _ in range(5)]
    moved = [(command.q_rad - before.q_rad)[KNEE] for command in after]
    np.testing.assert_allclose(moved, step * np.array([0.2, 0.4, 0.6, 0.8, 1.0, 1.0]), atol=1e-6)


def test_blending_begins_at_what_safety_let_through(folder):
    """The stand actor asks for more at the knee than 139 Nm allow: gains are lowered, and blending begins with them."""
    stand = linear_run(folder, {(GRAVITY_Z, "left_knee_joint"): -2.0}, name="far")
    stage = Stage(folder, stand=stand, tracked=[linear_run(folder, name="near")]).bring_to(Mode.READY)
    for _ in range(10):  # its own blending is over
        sent = stage().command
    offset_rad = sent.q_rad[KNEE] - ROBOT.default_pos_rad[KNEE]
    assert offset_rad * sent.kp[KNEE] == pytest.approx(139.0) and sent.kp[KNEE] < 149.0
    first = stage(Request.START).command
    assert first.q_rad[KNEE] - ROBOT.default_pos_rad[KNEE] == pytest.approx(0.8 * offset_rad, abs=1e-6)
    assert first.kp[KNEE] == pytest.approx(0.8 * sent.kp[KNEE] + 0.2 * ROBOT.kp[KNEE])


def test_the_start_pose_is_held_until_balancing_is_asked_for(folder):
    stage = Stage(folder).bring_to(Mode.FIXED_STAND)
    for _ in range(200):
        result = stage()
        assert result.mode is Mode.FIXED_STAND and result.actor is None
        np.testing.assert_allclose(result.command.q_rad, ROBOT.default_pos_rad, atol=1e-3)
        np.testing.assert_array_equal(result.command.kp, ROBOT.kp)
    hanging = stage(Request.STAND, reading=state(imu_quat_wxyz=tilted(0.2)))
    assert hanging.mode is Mode.FIXED_STAND
    assert hanging.refused == ("balancing refused: tilt 0.20 rad, limit 0.1",)
    assert stage(reading=state(imu_quat_wxyz=tilted(0.51))).fault.rule == "stand_up_tilt"


def test_gains_blend_too(folder):
    from deploy.safety.rules import Wish

    stage = Stage(folder).bring_to(Mode.READY)
    machine = stage.machine
    machine._sent = Wish(ROBOT.default_pos_rad, 0.5 * ROBOT.kp, 3.0 * ROBOT.kd)
    command = stage(Request.START).command
    np.testing.assert_allclose(command.kp, 0.6 * ROBOT.kp)
    np.testing.assert_allclose(command.kd, 2.6 * ROBOT.kd)


def test_each_start_begins_with_an_empty_memory(folder):
    """The action fed back makes the target grow; a new start makes it small again."""
    knee_action = 6 + KNEE
    weights = {(knee_action, "left_knee_joint"): 0.25, (GRAVITY_Z, "left_knee_joint"): -0.01}
    run = linear_run(folder, weights, name="grows", seconds=0.2)
    stage = Stage(folder, tracked=[run]).bring_to(Mode.READY)

    def play():
        results = [stage(Request.START)]
        while stage.machine.mode is Mode.TRACKING:
            results.append(stage())
        return [result.output.action[KNEE] for result in results[:10]]

    first = play()
    np.testing.assert_allclose(first, 0.04 * np.arange(1, 11), atol=1e-6)
    stage(Request.START)
    assert stage.machine.mode is Mode.TRACKING
    stage.until(Mode.HOLD)
    assert play() == first


def test_switch_selects_the_next_actor_and_start_plays_it(folder):
    runs = [linear_run(folder, name=name, seconds=0.2) for name in ("one", "two")]
    stage = Stage(folder, tracked=runs).bring_to(Mode.READY)
    stage(Request.SWITCH)
    assert stage(Request.START).actor is runs[1]
    stage.until(Mode.HOLD)
    stage(Request.SWITCH)
    assert stage(Request.START).actor is runs[0]


def test_hold_during_the_clip_hands_over_as_soon_as_it_may(folder):
    stage = Stage(folder).bring_to(Mode.TRACKING)
    assert stage(Request.HOLD, reading=OUTSIDE[0]).mode is Mode.TRACKING
    result = stage()
    assert result.mode is Mode.HOLD and result.actor is stage.stand


def test_without_a_stand_actor_the_end_of_the_clip_is_damped(folder):
    run = linear_run(folder, name="clip", seconds=0.2)
    machine = StateMachine(ROBOT, None, [run], FAST, PERIOD_S)
    tick = Tick(machine, Guard(ROBOT, FAST, PERIOD_S))
    assert tick(state(), [Request.STAND]).refused == ("stand refused: there is no stand actor",)
    machine.start_tracking()
    results = [tick(state()) for _ in range(12)]
    assert results[0].modes == (Mode.TRACKING,)
    assert [result.mode for result in results].count(Mode.TRACKING) == run.num_ticks == 10
    assert results[-1].mode is Mode.DAMPING and results[-1].fault is None


def test_an_action_that_is_not_a_number_is_never_sent(folder):
    stage = Stage(folder).bring_to(Mode.TRACKING)
    stage.machine.active.act = lambda s, lap=None: replace_target(stage, np.nan)
    result = stage()
    assert result.command is None and result.fault.rule == "action_not_finite" and result.mode is Mode.DAMPING


def test_an_infinite_action_is_never_sent_though_its_target_was_clipped(folder):
    """The action's clip makes a finite target of it: full torque for a tick."""
    stage = Stage(folder).bring_to(Mode.TRACKING)
    output = replace(replace_target(stage, 3.0), action=np.where(np.arange(JOINTS) == KNEE, np.inf, 0.0))
    stage.machine.active.act = lambda s, lap=None: output
    result = stage()
    assert result.command is None and result.mode is Mode.DAMPING
    assert str(result.fault) == "action_not_finite: action of left_knee_joint is not a number"


def replace_target(stage, value):
    from policy.controller import PolicyOutput

    target = ROBOT.default_pos_rad.copy()
    target[KNEE] = value
    return PolicyOutput(target.astype(np.float32), target, ROBOT.kp, ROBOT.kd, {})
