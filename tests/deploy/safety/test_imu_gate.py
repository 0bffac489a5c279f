"""One wrong sample of the IMU reaches neither actor nor rules; what a base can do is believed."""

from dataclasses import replace

import numpy as np
import pytest

from core.clock import SimulatedClock
from deploy.cell import Cell
from deploy.episode import place_at_reference
from deploy.safety.guard import Guard
from deploy.safety.rules import make_sample
from hal.simulated.mujoco import MujocoBackend
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, bundled_run, state, tilted
from world.options import load_sim_options

UPSIDE_DOWN = np.array([0.0, 1.0, 0.0, 0.0])
NO_RATE = np.zeros(3)
# what one sample says of a base at rest and upright
WRONG = {
    "upside down": (UPSIDE_DOWN, NO_RATE),
    "a lean of 0.65 rad": (tilted(0.65), NO_RATE),
    "the heading turned by a right angle": (np.array([0.7071067811865476, 0.0, 0.0, 0.7071067811865476]), NO_RATE),
    "a gyro at its full scale": (tilted(0.0), np.array([34.9, 0.0, 0.0])),
}


def said(tick, quat_wxyz, ang_vel_b):
    return state(time_s=tick * PERIOD_S, imu_quat_wxyz=quat_wxyz, imu_ang_vel_b=ang_vel_b)


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_what_no_turn_leads_to_is_not_shown_and_the_truth_after_it_is(wrong):
    guard, truth = Guard(ROBOT, SETTINGS, PERIOD_S), state()
    guard.believed(truth)
    reading = replace(said(1, *wrong), imu_acc_b=np.array([0.0, 0.0, -9.81]), imu_age_s=0.004)
    seen = guard.believed(reading)
    for name in ("imu_quat_wxyz", "imu_ang_vel_b", "imu_acc_b"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(truth, name))
    assert seen.imu_age_s == pytest.approx(PERIOD_S) and seen.joint_age_s is reading.joint_age_s
    after = state(time_s=2 * PERIOD_S)
    assert guard.believed(after) is after


@pytest.mark.parametrize(("wrong", "tick"), [([1, 2], None), ([1, 2, 4, 5], None), ([1, 2, 3], 3)])
def test_three_in_a_row_trip(wrong, tick):
    guard, tripped = Guard(ROBOT, SETTINGS, PERIOD_S), None
    for now in range(8):
        seen = guard.believed(said(now, *WRONG["upside down"]) if now in wrong else state(time_s=now * PERIOD_S))
        assert make_sample(seen).tilt_rad == 0.0
        fault = guard.check(make_sample(seen), moving=True)
        if fault is not None:
            tripped = now
            assert fault.rule == "implausible" and fault.detail == "the IMU turns by 3.14 rad in 60 ms at 0.0 rad/s"
            break
    assert tripped == tick


def test_at_rest_the_latest_sample_is_the_truth():
    """A robot that was damped may be turned over by whoever picks it up while nothing is read."""
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    guard.believed(state())
    assert guard.believed(said(1, UPSIDE_DOWN, NO_RATE)).imu_quat_wxyz[0] == 1.0
    guard.reset()
    latest = said(2, UPSIDE_DOWN, NO_RATE)
    assert guard.believed(latest) is latest


def turning(rates_rad_s):
    """Samples of a base that leans forward at these rates, each held until the next; as a perfect IMU says it."""
    angle_rad = 0.0
    for tick, rate in enumerate(rates_rad_s):
        yield said(tick, tilted(angle_rad), np.array([0.0, rate, 0.0]))
        angle_rad += rate * PERIOD_S


MOVES = {
    "a flip that ends in a landing": [0.0, 3.0, 6.0, 9.0, 11.0, 11.0, 11.0, 0.0, 0.0],
    "a landing that turns the base the other way": [8.0, 8.0, -3.0, -3.0],
    "a blow that turns a base at rest": [0.0, 0.0, 10.0, 10.0, 10.0],
    "ground under a fall": [14.0, 14.0, 0.0, 0.0],
}


@pytest.mark.parametrize("quiet", [0, 40], ids=["at the start", "once its noise is known"])
@pytest.mark.parametrize("stopped_after", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("rates", MOVES.values(), ids=MOVES)
def test_what_a_base_can_do_is_believed(rates, stopped_after, quiet):
    """Each change comes somewhere between two samples: the turn is not what the mean of both rates says."""
    guard, angle_rad = Guard(ROBOT, SETTINGS, PERIOD_S), 0.0
    rates = [*[rates[0]] * quiet, *rates]
    for tick, rate in enumerate(rates):
        if tick:
            angle_rad += (stopped_after * rates[tick - 1] + (1.0 - stopped_after) * rate) * PERIOD_S
        reading = said(tick, tilted(angle_rad), np.array([0.0, rate, 0.0]))
        assert guard.believed(reading) is reading, tick


def jittering(guard, half_width_rad, ticks, rng):
    """A base at rest whose IMU is off by uniform noise about one axis; what the guard did not believe, by tick."""
    refused = []
    for tick in range(ticks):
        reading = said(tick, tilted(rng.uniform(-half_width_rad, half_width_rad)), NO_RATE)
        if guard.believed(reading) is not reading:
            refused.append(tick)
    return refused


def test_a_small_jump_of_a_quiet_imu_is_refused_and_the_noise_of_another_believed():
    """0.2 rad: of a quiet IMU no turn leads there; of one that is off by 0.15 rad all the time, its noise does."""
    rng = np.random.default_rng(0)
    quiet, noisy = (Guard(ROBOT, SETTINGS, PERIOD_S) for _ in range(2))
    assert jittering(quiet, 0.002, 60, rng) == [] and jittering(noisy, 0.15, 400, rng) == []
    jump = said(60, tilted(0.2), NO_RATE)
    assert quiet.believed(jump) is not jump
    jump = said(400, tilted(0.2), NO_RATE)
    assert noisy.believed(jump) is jump


def test_what_is_no_number_is_no_noise():
    """Nor does it make a quiet IMU's jumps believed afterwards."""
    guard, rng = Guard(ROBOT, SETTINGS, PERIOD_S), np.random.default_rng(0)
    assert jittering(guard, 0.002, 60, rng) == []
    for tick in range(60, 75):
        guard.believed(said(tick, np.full(4, np.nan), NO_RATE))
    guard.believed(said(75, tilted(0.0), NO_RATE))
    jump = said(76, tilted(0.2), NO_RATE)
    assert guard.believed(jump) is not jump


def test_an_imu_that_says_the_same_twice_or_comes_late_is_believed():
    guard, readings = Guard(ROBOT, SETTINGS, PERIOD_S), list(turning([11.0] * 6))
    ages_s = (0.0, 0.0, PERIOD_S, 0.005, 0.0, 0.002)
    for tick, age_s in enumerate(ages_s):
        angle_rad = 11.0 * (tick * PERIOD_S - age_s)
        reading = replace(readings[tick], imu_quat_wxyz=tilted(angle_rad), imu_age_s=age_s)
        assert guard.believed(reading) is reading, tick


def test_a_sign_of_the_quaternion_is_no_turn():
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    guard.believed(state())
    flipped = said(1, -tilted(0.01), NO_RATE)
    assert guard.believed(flipped) is flipped


class LyingImu(MujocoBackend):
    """Every half second one sample of the IMU is wrong."""

    wrong = None
    readings = 0

    def read(self):
        self.readings += 1
        reading = super().read()
        if self.wrong is None or self.readings % 25:
            return reading
        return replace(reading, imu_quat_wxyz=self.wrong[0], imu_ang_vel_b=self.wrong[1])


@pytest.mark.parametrize("wrong", [WRONG["upside down"], WRONG["a gyro at its full scale"]], ids=["quaternion", "gyro"])
def test_standing_goes_on_through_them(wrong):
    clock, actor = SimulatedClock(), bundled_run("stand")
    cell = Cell(ROBOT, SETTINGS, [actor])
    with LyingImu(ROBOT, clock, load_sim_options("default"), gantry=False) as backend:
        place_at_reference(backend, actor, 0.0, np.random.default_rng(0))
        backend.wrong = wrong
        cell.loop(backend, clock, plan=cell.start_tracking(), duration_s=3.0).run()
        assert cell.machine.fault is None and backend.data.qpos[2] > 0.75
    assert cell.guard.counts["implausible"] == 6
