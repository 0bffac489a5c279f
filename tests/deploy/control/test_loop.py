"""The loop against a scripted device on a clock in the test's hands."""

from dataclasses import replace

import pytest

from core.clock import SimulatedClock
from deploy.control.loop import Loop
from deploy.control.modes import Mode, Request
from deploy.control.sequence import GantryRelease, OnlyTheClip, Unattended
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.safety.guard import Guard
from hal.contract.types import DeviceFault, LinkLost, NoState
from hal.open import open_backend
from tests.deploy.toys import KNEE, PERIOD_S, ROBOT, SETTINGS, Asked, FakeBackend, linear_run, state, with_joint

FAST = replace(
    SETTINGS,
    stand_up=replace(SETTINGS.stand_up, damping_s=0.04),
    sequence=replace(SETTINGS.sequence, steady_ready_s=0.2, after_release_s=0.1, hold_s=0.2, wait_s=3.0),
)


class Rig:
    def __init__(self, folder, script=None, *, read_takes_s=0.0, plan="unattended", operators=(), **options):
        self.clock = SimulatedClock(5.0)
        self.backend = FakeBackend(script or [state()], self.clock, read_takes_s=read_takes_s)
        stand, clip = linear_run(folder, name="stand"), linear_run(folder, name="clip", seconds=0.2)
        self.machine = StateMachine(ROBOT, stand, [clip], FAST, PERIOD_S)
        self.guard = Guard(ROBOT, FAST, PERIOD_S)
        self.release = GantryRelease(FAST, PERIOD_S)
        plans = {"unattended": lambda: Unattended(self.machine, self.release, FAST, PERIOD_S), "none": lambda: None}
        self.plan = plans[plan]()
        self.modes: list[Mode] = []
        self.released_in: list[Mode] = []
        self.loop = Loop(
            self.backend,
            self.clock,
            Tick(self.machine, self.guard),
            plan=self.plan,
            release=self.release,
            operators=operators,
            observers=[self.watch],
            **options,
        )

    def watch(self, state, result, timer):
        self.modes += result.modes
        if self.backend.released and not self.released_in:
            self.released_in.append(result.mode)


def test_unattended_walks_all_states_and_ends_damped(tmp_path):
    rig = Rig(tmp_path)
    rig.loop.run()
    standing = [Mode.DAMPING, Mode.STAND_UP, Mode.READY, Mode.TRACKING, Mode.HOLD]
    assert rig.modes == [*standing, Mode.LOWERING, Mode.DAMPING]
    assert rig.released_in == [Mode.READY]
    assert rig.loop.ended_by == "plan" and rig.plan.failure is None and rig.machine.fault is None
    assert rig.backend.calls[-1] == "damp" and rig.loop.timer.overruns == 0


def test_commands_keep_to_absolute_deadlines_whatever_the_work_takes(tmp_path):
    rig = Rig(tmp_path, read_takes_s=0.007)
    rig.loop.run()
    times = [time_s - 5.007 for time_s in rig.backend.write_times_s]
    ticks = [time_s / PERIOD_S for time_s in times]
    assert max(abs(tick - round(tick)) for tick in ticks) < 1e-6
    assert rig.loop.timer.overruns == 0


def test_overruns_are_counted_and_missed_deadlines_skipped(tmp_path):
    """Work of 2.5 periods: each tick ends half a period after a deadline, and the next begins at once."""
    rig = Rig(tmp_path, read_takes_s=0.05, plan="none", duration_s=0.5)
    rig.loop.run()
    assert rig.loop.timer.overruns == rig.loop.timer.ticks == 10


def test_lateness_is_counted_from_the_deadline(tmp_path):
    """Ticks of 27 ms begin at 0, 27, 54, ... ms; their deadlines are the multiples of 20 before: 15 ms at 135."""
    rig = Rig(tmp_path, read_takes_s=0.027, plan="none", duration_s=0.17)
    rig.loop.run()
    assert rig.loop.timer.report()["late_ms"]["max"] == pytest.approx(15.0)


def test_state_age_is_counted_when_the_command_leaves(tmp_path):
    rig = Rig(tmp_path, [state(imu_age_s=0.004, joint_age_s=with_joint("joint_age_s", 0.009).joint_age_s)])
    rig.loop.run()
    assert rig.loop.timer.report()["state_age_ms"]["p50"] == pytest.approx(9.0)


@pytest.mark.parametrize("mode", [Mode.DAMPING, Mode.STAND_UP, Mode.READY, Mode.TRACKING, Mode.HOLD, Mode.LOWERING])
@pytest.mark.parametrize("request_", [Request.QUIT, Request.DAMP])
def test_a_stop_in_any_state_takes_effect_within_one_tick(tmp_path, mode, request_):
    rig = Rig(tmp_path)

    class WhenReached:
        done = False

        def poll(self):
            if rig.machine.mode is mode and not self.done:
                self.done = True
                rig.backend.calls.clear()
                return (request_,)
            return ()

    rig.loop._operators = [WhenReached()]
    rig.loop.run()
    assert "write" not in rig.backend.calls and rig.backend.calls[0] == "damp"
    assert rig.machine.latched and rig.machine.fault is None
    assert rig.loop.ended_by == ("operator" if request_ is Request.QUIT else "plan")


def test_duration_ends_it_damped(tmp_path):
    rig = Rig(tmp_path, duration_s=0.3)
    rig.loop.run()
    assert rig.loop.ended_by == "duration" and rig.clock.now_s() == pytest.approx(5.3)
    assert rig.machine.mode is Mode.DAMPING and rig.backend.calls[-1] == "damp"


@pytest.mark.parametrize(
    ("error", "rule"),
    [(LinkLost("gone"), "link_loss"), (NoState("none"), "link_loss"), (DeviceFault("hot"), "device_fault")],
)
def test_a_failed_read_damps_on_that_tick(tmp_path, error, rule):
    rig = Rig(tmp_path, [state()] * 40 + [error])
    rig.loop.run()
    assert rig.machine.fault.rule == rule and str(error) in rig.machine.fault.detail
    assert rig.backend.calls[40] == "damp" and "write" not in rig.backend.calls[40:]


def test_a_failed_write_is_a_lost_link_on_the_next_tick(tmp_path):
    rig = Rig(tmp_path)
    rig.backend.fail_write = LinkLost("cannot send")
    rig.loop.run()
    assert rig.machine.fault.rule == "link_loss" and "cannot send" in rig.machine.fault.detail


def test_anything_that_raises_leaves_the_joints_damped(tmp_path):
    rig = Rig(tmp_path, [state()] * 40 + [ZeroDivisionError("bug")])
    with pytest.raises(ZeroDivisionError):
        rig.loop.run()
    assert rig.backend.calls[-1] == "damp"


def test_a_frozen_loop_comes_back_to_a_latched_dead_man(tmp_path):
    """The device damps by itself after 3 periods; the loop, awake again, trips on what the device reports."""
    rig = Rig(tmp_path)
    backend = open_backend("mock", ROBOT, rig.clock)
    rig.loop._backend = backend

    def freeze_once(state, result, timer):
        if timer.ticks == 30:
            rig.clock.sleep_until(rig.clock.now_s() + 0.2)

    rig.loop._observers.append(freeze_once)
    with backend:
        rig.loop.run()
    assert str(rig.machine.fault) == "device_fault: dead_man"
    assert rig.loop.timer.overruns == 1 and rig.loop.timer.ticks in (31, 32)


def test_acknowledging_reaches_the_device(tmp_path):
    asked = Asked({0: [Request.DAMP], 3: [Request.ACKNOWLEDGE], 6: [Request.QUIT]})
    rig = Rig(tmp_path, plan="none", operators=[asked])
    rig.loop.run()
    assert rig.backend.calls == ["damp"] * 3 + ["acknowledge"] + ["damp"] * 2
    assert rig.modes == [Mode.DAMPING, Mode.IDLE]


def test_the_plan_gives_up_saying_why(tmp_path):
    rig = Rig(tmp_path, [with_joint("joint_pos_rad", ROBOT.default_pos_rad[KNEE] + 0.2)])
    rig.loop.run()
    assert rig.loop.ended_by == "plan" and rig.plan.failure.startswith("STAND_UP never led on")
    assert rig.machine.fault is None


def test_slow_inference_trips_on_the_loop_s_clock(tmp_path):
    rig = Rig(tmp_path)
    infer = rig.machine._stand._controller.act

    def slow(*arguments, **named):
        rig.clock.sleep_until(rig.clock.now_s() + 0.03)
        return infer(*arguments, **named)

    rig.machine._stand._controller.act = slow
    rig.loop.run()
    assert rig.machine.fault.rule == "inference_overrun" and rig.guard.counts["inference_overrun"] == 3


def test_one_slow_inference_is_judged_once(tmp_path):
    """In LOWERING no actor acts: what the last one took says nothing of the ticks after it."""
    rig = Rig(tmp_path, plan="none", operators=[Asked({0: [Request.STAND]})])
    infer = rig.machine._stand._controller.act

    def slow_once(*arguments, **named):
        rig.machine._stand._controller.act = infer
        rig.clock.sleep_until(rig.clock.now_s() + 0.03)
        rig.machine.request(Request.FINISH, state())
        return infer(*arguments, **named)

    rig.machine._stand._controller.act = slow_once
    rig.loop._duration_s = 12.0
    rig.loop.run()
    assert rig.modes[-2:] == [Mode.LOWERING, Mode.DAMPING] and rig.machine.fault is None
    assert rig.guard.counts["inference_overrun"] == 1


def test_only_the_clip(tmp_path):
    rig = Rig(tmp_path, plan="none")
    rig.machine.start_tracking()
    rig.loop._plan = OnlyTheClip(rig.machine)
    rig.loop.run()
    assert rig.modes == [Mode.TRACKING, Mode.DAMPING]
    assert len(rig.backend.commands) == 10 and rig.loop.timer.ticks == 11


def test_the_gantry_waits_for_steadiness(tmp_path):
    release = GantryRelease(FAST, PERIOD_S)
    swaying = state(imu_ang_vel_b=state().imu_ang_vel_b + 0.4)
    for _ in range(4):
        assert not any(release.due(Mode.READY, state()) for _ in range(9))
        assert not release.due(Mode.READY, swaying)
    answers = [release.due(Mode.READY, state()) for _ in range(30)]
    assert answers.index(True) == 10 and answers.count(True) == 1


def test_a_robot_that_was_never_commanded_is_left_as_it_was(tmp_path):
    """A robot that stands by its own controller must not go limp because somebody looked and left."""

    class Leaves:
        def poll(self):
            return (Request.QUIT,)

    rig = Rig(tmp_path, plan="none", operators=[Leaves()])
    rig.loop.run()
    assert rig.loop.ended_by == "operator"
    assert "damp" not in rig.backend.calls and "write" not in rig.backend.calls


def test_a_fault_before_the_first_command_drives_nothing(tmp_path):
    rig = Rig(tmp_path, [state()] * 3 + [DeviceFault("hot")], plan="none", operators=[Asked({8: [Request.QUIT]})])
    rig.loop.run()
    assert rig.machine.fault.rule == "device_fault"
    assert "damp" not in rig.backend.calls and "write" not in rig.backend.calls


def test_an_operator_may_damp_a_robot_that_was_never_commanded(tmp_path):
    rig = Rig(tmp_path, [DeviceFault("hot")], plan="none", operators=[Asked({2: [Request.DAMP], 4: [Request.QUIT]})])
    rig.loop.run()
    assert rig.backend.calls == ["damp"] * 4  # at ticks 2, 3, 4 and when the loop ends
