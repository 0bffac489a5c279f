"""What every backend must do, whatever it drives."""

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hal.contract.backend import Backend, Placeable
from hal.contract.types import DeviceError, RobotState
from hal.open import WIRES
from tests.hal.conformance.rigs import Rig, make_rig, make_wire, ready, rig_names, wait_until
from tests.hal.rigs import PERIOD_S, hold, pass_time, run
from world.actuation import JointCommand

# What a device's own scaling of a torque may add to a bound.
SCALING_NM = 0.5


@pytest.fixture(scope="module", params=rig_names())
def rig_name(request: pytest.FixtureRequest) -> str:
    """Of the module's scope, so that all tests of one backend follow one another. The wires' are real_time."""
    return request.param


@pytest.fixture
def rig(rig_name: str, request: pytest.FixtureRequest) -> Iterator[Rig]:
    """Only a wire needs the emulators, and the precedence that comes with them."""
    wired = rig_name in WIRES
    made = make_wire(rig_name, request.getfixturevalue("running")) if wired else make_rig(rig_name)
    yield made
    made.backend.close()


@pytest.fixture
def backend(rig: Rig) -> Any:
    return rig.backend


def test_is_a_backend(backend: Any) -> None:
    assert isinstance(backend, Backend)
    assert backend.control_period_s >= PERIOD_S


def test_open_names_the_device_and_its_joints_in_the_robots_order(backend: Any) -> None:
    info = backend.open()
    assert info.name
    assert info.joint_names == backend.robot.joint_names


def test_nothing_is_readable_or_writable_before_open_and_after_close(backend: Any) -> None:
    for _ in range(2):
        with pytest.raises(DeviceError):
            backend.read()
        with pytest.raises(DeviceError):
            backend.write(hold(backend.robot))
        backend.open()
        ready(backend)
        backend.close()


def test_opening_does_not_energise(rig: Rig, backend: Any) -> None:
    with backend:
        start = ready(backend).joint_pos_rad
        pass_time(backend, 0.3 if rig.emulator else PERIOD_S)
        state = backend.read()
        # Only damping: the torque opposes the speed of the joint, up to what the last step changed.
        assert _is_damped(backend, state)
        assert np.abs(state.joint_pos_rad - start).max() < (0.5 if rig.emulator else 0.05)
        if rig.emulator:
            assert set(rig.emulator.control.status()["mode"].values()) == {"slack"}


def test_devices_are_energised_by_the_first_command_and_say_so(rig: Rig, backend: Any) -> None:
    with backend:
        assert not ready(backend).energised
        backend.damp()
        _wait(rig, lambda: backend.read().energised)
        assert backend.read().energised


def test_states_are_complete_finite_and_upright_and_carry_the_clocks_time(rig: Rig, backend: Any) -> None:
    with backend:
        ready(backend)
        pass_time(backend, PERIOD_S)
        state = backend.read()
        assert isinstance(state, RobotState)
        assert 0 <= backend.clock.now_s() - state.time_s <= (rig.late_s if rig.wall else 0.0)
        for value in (state.joint_pos_rad, state.joint_vel_rad_s, state.joint_torque_nm, state.joint_age_s):
            assert value.shape == (backend.robot.num_joints,)
            assert np.isfinite(value).all()
        assert np.linalg.norm(state.imu_quat_wxyz) == pytest.approx(1.0, abs=1e-3)
        assert abs(state.imu_quat_wxyz[0]) > 0.95
        assert state.faults == ()


def test_ages_are_true_and_below_a_step(rig: Rig, backend: Any) -> None:
    newest_s = PERIOD_S + rig.late_s if rig.wall else 0.005 + 1e-9
    with backend:
        ready(backend)
        for pause_s in (0.02, 0.0134, 0.0077, 0.0):
            pass_time(backend, pause_s)
            state = backend.read()
            assert ((state.joint_age_s >= 0) & (state.joint_age_s < newest_s)).all()
            assert 0 <= state.imu_age_s < newest_s


def test_states_are_snapshots(backend: Any) -> None:
    with backend:
        first = ready(backend)
        copies = [np.copy(getattr(first, name)) for name in ("joint_pos_rad", "joint_vel_rad_s", "imu_quat_wxyz")]
        run(backend, hold(backend.robot), 0.1)
        for name, copy in zip(("joint_pos_rad", "joint_vel_rad_s", "imu_quat_wxyz"), copies):
            np.testing.assert_array_equal(getattr(first, name), copy)


def test_joints_follow_their_targets(backend: Any) -> None:
    with backend:
        start = ready(backend).joint_pos_rad
        target = start + np.where(np.arange(start.size) % 2, 0.1, -0.1)
        target = np.clip(target, backend.robot.pos_lower_rad, backend.robot.pos_upper_rad)
        state = run(backend, hold(backend.robot, target), 1.0)
        moved = np.abs(state.joint_pos_rad - target).mean()
        assert moved < 0.5 * np.abs(start - target).mean()


def test_torque_stays_within_the_limits(rig: Rig, backend: Any) -> None:
    with backend:
        ready(backend)
        far = hold(backend.robot, backend.robot.pos_upper_rad + 3.0, kp_scale=5.0)
        for _ in range(5):
            backend.write(far)
            pass_time(backend, PERIOD_S)
            torque_nm = np.abs(backend.read().joint_torque_nm)
            scaling_nm = SCALING_NM if rig.emulator else 1e-9 * backend.robot.torque_limit_nm
            assert (torque_nm <= backend.robot.torque_limit_nm + scaling_nm).all()


@pytest.mark.parametrize("bad", ["nan", "gain", "shape"])
def test_a_bad_command_cannot_be_made(backend: Any, bad: str) -> None:
    good = hold(backend.robot)
    changes = {
        "nan": {"q_rad": np.full_like(good.q_rad, np.nan)},
        "gain": {"kp": -good.kp},
        "shape": {"kd": good.kd[:-1]},
    }[bad]
    fields = {name: getattr(good, name) for name in ("q_rad", "dq_rad_s", "kp", "kd", "tau_nm")}
    with pytest.raises(ValueError, match=r"JointCommand"):
        JointCommand(**(fields | changes))


def test_a_command_for_another_number_of_joints_is_refused(backend: Any) -> None:
    zero = np.zeros(backend.robot.num_joints + 1)
    with backend, pytest.raises(ValueError, match="joints"):
        backend.write(JointCommand(zero, zero, zero, zero, zero))


def test_a_frozen_loop_ends_in_damping_which_latches(rig: Rig, backend: Any) -> None:
    """The times themselves are exact on a simulated clock, and never short on any."""
    with backend:
        ready(backend)
        command = hold(backend.robot, np.clip(backend.robot.default_pos_rad + 0.3, -0.9, 0.7))
        run(backend, command, 0.2)  # the last command is one period old
        if rig.wall:
            backend.write(command)
            written_s = backend.clock.now_s()
            wait_until(lambda: backend.read().faults)
            assert backend.clock.now_s() - written_s > 3 * rig.period_s
        else:
            pass_time(backend, 2 * PERIOD_S)
            assert backend.read().faults == ()
            pass_time(backend, 2e-3)
        assert backend.read().faults == ("dead_man",)
        pass_time(backend, 0.5)
        assert _is_damped(backend, backend.read())
        command = hold(backend.robot, np.clip(backend.robot.default_pos_rad - 0.3, -0.9, 0.7))
        state = run(backend, command, 0.2)
        assert state.faults == ("dead_man",)
        assert _is_damped(backend, state)
        backend.acknowledge()
        _wait(rig, lambda: backend.read().faults == ())
        state = backend.read()
        assert state.faults == ()
        assert _is_damped(backend, state)
        before = state.joint_pos_rad
        state = run(backend, command, (10 if rig.wall else 2) * PERIOD_S)
        assert state.faults == ()
        assert np.abs(state.joint_pos_rad - before).max() > 0.02


def test_a_command_that_comes_as_the_dead_man_expires_is_not_obeyed(
    rig: Rig, backend: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with backend:
        ready(backend)
        far = np.clip(backend.robot.default_pos_rad + 0.3, -0.9, 0.7)
        run(backend, hold(backend.robot), 0.2)
        pass_time(backend, 3 * rig.period_s - (0.0 if rig.wall else PERIOD_S))
        backend.read()
        now_s, calls = backend.clock.now_s, iter(range(10**6))
        monkeypatch.setattr(backend.clock, "now_s", lambda: now_s() + 1e-5 * next(calls))
        backend.write(hold(backend.robot, far))
        monkeypatch.undo()
        pass_time(backend, 0.5)
        state = backend.read()
        assert state.faults == ("dead_man",)
        assert _is_damped(backend, state)


def test_damping_needs_no_renewal_and_is_no_fault(rig: Rig, backend: Any) -> None:
    with backend:
        ready(backend)
        run(backend, hold(backend.robot), 0.1)
        backend.damp()
        pass_time(backend, 1.0)
        state = backend.read()
        assert state.faults == ()
        assert _is_damped(backend, state)
        if rig.emulator:
            assert set(rig.emulator.control.status()["mode"].values()) == {"damped"}


def test_damp_works_at_once_after_open_before_any_state(backend: Any) -> None:
    with backend:
        backend.damp()
        backend.damp()
        assert ready(backend).faults == ()


def drive(backend: Any) -> None:
    """Hold until the devices obey, which takes them a moment, and a moment longer."""
    wait_until(lambda: run(backend, hold(backend.robot), 0.1).energised)
    run(backend, hold(backend.robot), 0.1)


class Interruption(Exception):
    pass


@pytest.mark.parametrize("error", [None, Interruption, KeyboardInterrupt, SystemExit])
def test_leaving_damps_first_and_then_disables_whatever_happened(
    rig: Rig, backend: Any, error: type[BaseException] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[str, float]] = []
    damp, disable = backend.damp, backend._disable
    monkeypatch.setattr(backend, "damp", lambda: (calls.append(("damp", backend.clock.now_s())), damp()))
    monkeypatch.setattr(backend, "_disable", lambda: (calls.append(("disable", backend.clock.now_s())), disable()))
    try:
        with backend:
            ready(backend)
            drive(backend)
            start_s = backend.clock.now_s()
            if error is not None:
                raise error
    except (Interruption, KeyboardInterrupt, SystemExit):
        pass
    names = [name for name, _ in calls]
    assert names[0] == "damp"
    assert names.index("disable") == len(calls) - 1
    assert names.count("damp") > (3 if rig.wall else 20)
    assert 0.5 <= calls[-1][1] - start_s <= 3.0 + rig.period_s + rig.late_s
    if rig.emulator:
        assert set(rig.emulator.control.status()["mode"].values()) == {"slack"}


def test_closing_again_changes_nothing(backend: Any) -> None:
    backend.close()
    with backend:
        pass
    now_s = time.monotonic()
    backend.close()
    assert time.monotonic() - now_s < 0.1


def test_closing_disables_even_where_the_link_is_dead(rig: Rig, backend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def dead(*_: object) -> None:
        raise DeviceError("dead")

    disabled: list[float] = []
    disable = backend._disable
    with backend:
        ready(backend)
        drive(backend)
        monkeypatch.setattr(backend, "read", dead)
        monkeypatch.setattr(backend, "_disable", lambda: (disabled.append(backend.clock.now_s()), disable()))
        start_s = backend.clock.now_s()
    assert len(disabled) == 1
    assert disabled[0] - start_s == pytest.approx(3.0, abs=2 * rig.period_s + rig.late_s)


def test_an_episode_begins_anywhere_damped(backend: Any) -> None:
    if not isinstance(backend, Placeable):
        pytest.skip("no simulated placing on a device")
    with backend:
        run(backend, hold(backend.robot), 0.1)
        pose = backend.robot.default_pos_rad + 0.05
        backend.reset_to(np.array([0.0, 0.0, 2.0]), np.array([1.0, 0.0, 0.0, 0.0]), pose)
        state = backend.read()
        np.testing.assert_allclose(state.joint_pos_rad, pose)
        np.testing.assert_array_equal(state.joint_vel_rad_s, 0.0)
        assert _is_damped(backend, state)


def _wait(rig: Rig, condition: Any) -> None:
    """One period on a simulated clock, as long as it takes on the machine's."""
    if rig.wall:
        wait_until(condition)
    else:
        pass_time(rig.backend, PERIOD_S)


def _is_damped(backend: Any, state: RobotState) -> bool:
    """Every torque is what damping alone gives (its speed a step ago), up to the change of speed in one step."""
    bound_nm = backend.robot.damping_kd * np.abs(state.joint_vel_rad_s) + SCALING_NM
    return bool((np.abs(state.joint_torque_nm) <= bound_nm).all())
