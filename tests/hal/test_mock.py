"""The mock: ideal joints, and every fault seen from outside."""

import numpy as np
import pytest

from core.errors import InputError
from core.rotations import projected_gravity
from hal.contract.types import LinkLost, NoState, RobotState
from hal.simulated.faults import KINDS, MockFault
from tests.hal.rigs import G1, PERIOD_S, UPRIGHT, hold, mock, pass_time, run

KNEE = "left_knee_joint"
K = G1.joint_names.index(KNEE)


def at(fault: MockFault, t_s: float) -> RobotState:
    """The state t_s after opening, read every period on the way."""
    backend = mock(fault)
    backend.open()
    for _ in range(round(t_s / PERIOD_S)):
        backend.write(hold(G1))
        pass_time(backend, PERIOD_S)
        state = backend.read()
    return state


# Joints


def test_a_joint_approaches_its_target_exponentially() -> None:
    backend = mock(joint_lag_s=0.05)
    with backend:
        backend.reset_to(np.zeros(3), UPRIGHT, G1.default_pos_rad)
        target = G1.default_pos_rad + 0.1
        backend.write(hold(G1, target))
        pass_time(backend, 0.05)
        reached = backend.read().joint_pos_rad - G1.default_pos_rad
        np.testing.assert_allclose(reached, 0.1 * (1 - np.exp(-1.0)))


def test_a_joint_is_no_faster_than_its_limit_and_stops_at_the_end_of_its_range() -> None:
    backend = mock()
    with backend:
        far = G1.pos_upper_rad + 2.0
        for _ in range(200):
            backend.write(hold(G1, far))
            pass_time(backend, PERIOD_S)
            state = backend.read()
            assert (np.abs(state.joint_vel_rad_s) <= G1.vel_limit_rad_s * (1 + 1e-9)).all()
        np.testing.assert_allclose(state.joint_pos_rad, G1.pos_upper_rad)
        np.testing.assert_array_equal(state.joint_vel_rad_s, 0.0)


def test_damped_joints_stay() -> None:
    backend = mock()
    with backend:
        before = run(backend, hold(G1), 0.06).joint_pos_rad
        backend.damp()
        pass_time(backend, 1.0)
        state = backend.read()
        np.testing.assert_array_equal(state.joint_pos_rad, before)
        np.testing.assert_array_equal(state.joint_vel_rad_s, 0.0)


def test_what_it_cannot_know_it_does_not_say() -> None:
    with mock() as backend:
        assert backend.read().truth is None


# Faults


def test_link_loss_raises_on_reading_and_writing() -> None:
    backend = mock(MockFault("link_loss", 0.1, 0.1))
    backend.open()
    pass_time(backend, 0.1)
    with pytest.raises(LinkLost):
        backend.read()
    with pytest.raises(LinkLost):
        backend.write(hold(G1))
    backend.damp()
    pass_time(backend, 0.1)
    backend.read()


def test_no_state_at_first() -> None:
    backend = mock(MockFault("no_state", 0.0, 0.1))
    backend.open()
    with pytest.raises(NoState):
        backend.read()
    pass_time(backend, 0.1)
    backend.read()


def test_silence_from_the_start_is_no_state_either() -> None:
    backend = mock(MockFault("silence", 0.0))
    backend.open()
    with pytest.raises(NoState):
        backend.read()


def test_a_joint_that_never_answered_leaves_the_state_incomplete() -> None:
    backend = mock(MockFault("stale_joint", 0.0, joint=KNEE))
    backend.open()
    with pytest.raises(NoState):
        backend.read()


def test_silence_ages_everything_and_then_counts_as_a_dead_link() -> None:
    backend = mock(MockFault("silence", 0.1))
    backend.open()
    run(backend, hold(G1), 0.08)
    frozen = backend.read()
    for late_s in (0.02, 0.04, 0.06, 0.08, 0.1):
        backend.write(hold(G1, G1.default_pos_rad + 0.3))
        pass_time(backend, PERIOD_S)
        state = backend.read()
        np.testing.assert_allclose(state.joint_age_s, late_s, atol=1e-9)
        assert state.imu_age_s == pytest.approx(late_s)
        np.testing.assert_array_equal(state.joint_pos_rad, frozen.joint_pos_rad)
    pass_time(backend, PERIOD_S)
    with pytest.raises(LinkLost):
        backend.read()


def test_one_stale_joint_keeps_its_value_and_tells_its_age() -> None:
    backend = mock(MockFault("stale_joint", 0.05, 0.06, joint=KNEE))
    backend.open()
    before = run(backend, hold(G1), 0.04).joint_pos_rad[K]
    state = run(backend, hold(G1, G1.default_pos_rad + 0.5), 0.06)
    assert state.joint_pos_rad[K] == before
    assert state.joint_age_s[K] == pytest.approx(0.06)
    others = np.arange(G1.num_joints) != K
    np.testing.assert_array_equal(state.joint_age_s[others], 0.0)
    assert state.imu_age_s == 0.0
    state = run(backend, hold(G1), 0.02)
    assert state.joint_age_s[K] == 0.0
    assert state.joint_pos_rad[K] != before


def test_a_stale_imu_ages_alone() -> None:
    state = at(MockFault("stale_imu", 0.05), 0.1)
    assert state.imu_age_s == pytest.approx(0.06)
    np.testing.assert_array_equal(state.joint_age_s, 0.0)


@pytest.mark.parametrize(
    ("kind", "joint", "field"),
    [
        ("nan_position", KNEE, "joint_pos_rad"),
        ("nan_velocity", KNEE, "joint_vel_rad_s"),
        ("nan_quaternion", None, "imu_quat_wxyz"),
        ("nan_gyro", None, "imu_ang_vel_b"),
    ],
)
def test_values_that_are_no_numbers_are_passed_on_as_they_are(kind: str, joint: str | None, field: str) -> None:
    state = at(MockFault(kind, 0.05, 0.1, joint=joint), 0.1)
    struck = np.isnan(getattr(state, field))
    assert struck.sum() == (1 if joint else struck.size)
    if joint:
        assert struck[K]
    for other in ("joint_pos_rad", "joint_vel_rad_s", "imu_quat_wxyz", "imu_ang_vel_b", "imu_acc_b"):
        assert other == field or np.isfinite(getattr(state, other)).all()
    assert np.isfinite(getattr(at(MockFault(kind, 0.05, 0.1, joint=joint), 0.2), field)).all()


def test_over_temperature() -> None:
    state = at(MockFault("over_temperature", 0.0, joint=KNEE), 0.1)
    assert state.temperature_c is not None
    assert state.temperature_c[K] == 120.0
    assert np.delete(state.temperature_c, K).max() < 50.0


def test_device_fault_names_the_motor() -> None:
    assert at(MockFault("device_fault", 0.0, joint=KNEE), 0.1).faults == (f"motor_fault:{KNEE}",)


def test_a_stuck_joint_does_not_move() -> None:
    state = at(MockFault("stuck_joint", 0.0, joint=KNEE), 2.0)
    assert state.joint_pos_rad[K] == 0.0
    np.testing.assert_allclose(np.delete(state.joint_pos_rad, K), np.delete(G1.default_pos_rad, K), atol=1e-3)


def test_a_joint_past_its_range() -> None:
    state = at(MockFault("past_range", 0.0, joint=KNEE, value=0.15), 0.1)
    assert state.joint_pos_rad[K] == pytest.approx(G1.pos_upper_rad[K] + 0.15)


def test_overspeed() -> None:
    assert at(MockFault("overspeed", 0.0, joint=KNEE), 0.1).joint_vel_rad_s[K] == 60.0


def test_tilt_turns_gravity_and_the_accelerometer_together() -> None:
    state = at(MockFault("tilt", 0.0, value=0.7), 0.1)
    gravity_b = projected_gravity(state.imu_quat_wxyz)
    np.testing.assert_allclose(gravity_b, [np.sin(0.7), 0.0, -np.cos(0.7)], atol=1e-12)
    np.testing.assert_allclose(state.imu_acc_b, -9.81 * gravity_b, atol=1e-12)


def test_a_slow_read_takes_its_time() -> None:
    backend = mock(MockFault("slow_read", 0.0, value=0.03))
    backend.open()
    assert backend.read().time_s == pytest.approx(0.03)


def test_write_error() -> None:
    backend = mock(MockFault("write_error", 0.0))
    backend.open()
    with pytest.raises(LinkLost):
        backend.write(hold(G1))
    backend.read()


@pytest.mark.parametrize("kind", KINDS)
def test_closing_works_through_every_fault(kind: str) -> None:
    needs_joint = KINDS[kind][0]
    backend = mock(MockFault(kind, 0.1, joint=KNEE if needs_joint else None))
    with backend:
        run(backend, hold(G1), 0.08)
        pass_time(backend, 0.04)
    with pytest.raises(LinkLost):
        backend.write(hold(G1))


@pytest.mark.parametrize(
    ("entries", "text"),
    [
        ({"kind": "gremlin", "start_s": 0.0}, "unknown fault, got gremlin, expected one of link_loss"),
        ({"kind": "tilt", "start_s": -1.0}, "start_s: too small, got -1.0, expected at least 0 s"),
        ({"kind": "tilt", "start_s": float("nan")}, "start_s: not finite, got nan"),
        (
            {"kind": "tilt", "start_s": 0.0, "duration_s": 0.0},
            "duration_s: not positive, got 0.0, expected a number above 0 s",
        ),
        (
            {"kind": "stale_joint", "start_s": 0.0},
            "joint: wrong joint entry for stale_joint, expected the name of a joint",
        ),
        (
            {"kind": "tilt", "start_s": 0.0, "joint": KNEE},
            f"joint: wrong joint entry for tilt, got {KNEE}, expected no joint",
        ),
        (
            {"kind": "silence", "start_s": 0.0, "value": 1.0},
            "value: wrong value for silence, got 1.0, expected no value",
        ),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(entries: dict, text: str) -> None:
    with pytest.raises(InputError, match=text):
        MockFault(**entries)


def test_a_fault_on_an_unknown_joint_is_refused() -> None:
    with pytest.raises(InputError, match=r"unknown joint, got left_wing_joint, expected one of left_hip"):
        mock(MockFault("stale_joint", 0.0, joint="left_wing_joint"))
