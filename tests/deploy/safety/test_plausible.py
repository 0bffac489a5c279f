"""One wrong sample never becomes torque. Judged by what the joint, where it truly is, gets of the command."""

from dataclasses import replace

import numpy as np
import pytest

from core.clock import SimulatedClock
from deploy.cell import Cell
from deploy.episode import place_at_reference
from deploy.safety.guard import Guard
from deploy.safety.rules import Wish, make_sample
from hal.simulated.mujoco import MujocoBackend
from tests.deploy.toys import JOINTS, KNEE, PERIOD_S, ROBOT, SETTINGS, bundled_run, state, with_joint
from world.options import load_sim_options

WAIST = ROBOT.joint_names.index("waist_pitch_joint")
HIP = ROBOT.joint_names.index("left_hip_pitch_joint")
PAST_SOFT_RAD = ROBOT.soft_pos_limits_rad()[1][KNEE] + 0.02
# joint, where it truly is (None: in the default pose), what one sample says: position (added or alone) and speed
WRONG = {
    "knee 2 rad further": (KNEE, None, 2.0, 0.0),
    "knee 2 rad back": (KNEE, None, -2.0, 0.0),
    "waist 2 rad further": (WAIST, None, 2.0, 0.0),
    "waist at 36 rad/s": (WAIST, None, 0.0, 36.0),
    "hip at -31 rad/s": (HIP, None, 0.0, -31.0),
    "past the soft limit at -30 rad/s": (KNEE, PAST_SOFT_RAD, 0.0, -30.0),
    "a billion rad": (KNEE, None, 1e9, 0.0),
    "knee 2 rad further at 90 rad/s": (KNEE, None, 2.0, 90.0),
}


def lie(truth, joint, further_rad, speed_rad_s):
    pos_rad, vel_rad_s = truth.joint_pos_rad.copy(), truth.joint_vel_rad_s.copy()
    pos_rad[joint] += further_rad
    vel_rad_s[joint] += speed_rad_s
    return replace(truth, joint_pos_rad=pos_rad, joint_vel_rad_s=vel_rad_s)


def true_nm(command, truth):
    return command.kp * (command.q_rad - truth.joint_pos_rad) - command.kd * truth.joint_vel_rad_s


@pytest.mark.parametrize("gate", [True, False], ids=["gate", "limits alone"])
@pytest.mark.parametrize("case", WRONG.values(), ids=WRONG)
def test_a_wish_for_no_torque_gives_none(case, gate):
    """Without either, the guard itself drove the waist with 750 Nm, the knee with 161 Nm."""
    joint, at_rad, further_rad, speed_rad_s = case
    truth = state() if at_rad is None else with_joint("joint_pos_rad", at_rad, joint)
    guard, wish = Guard(ROBOT, SETTINGS, PERIOD_S), Wish(truth.joint_pos_rad, ROBOT.kp, ROBOT.kd)
    for tick in range(3):
        guard.command(wish, guard.believed(replace(truth, time_s=tick * PERIOD_S)))
    wrong = lie(replace(truth, time_s=3 * PERIOD_S), joint, further_rad, speed_rad_s)
    seen = guard.believed(wrong) if gate else wrong
    np.testing.assert_allclose(true_nm(guard.command(wish, seen), truth), 0.0, atol=1e-9)
    if gate:
        np.testing.assert_array_equal(seen.joint_pos_rad, truth.joint_pos_rad)
        np.testing.assert_array_equal(seen.joint_vel_rad_s, truth.joint_vel_rad_s)
        assert seen.joint_age_s[joint] == pytest.approx(PERIOD_S)
        assert seen.joint_age_s.sum() == seen.joint_age_s[joint]


@pytest.mark.parametrize("kd", [50.0, 200.0])
def test_a_brake_stays_a_brake_while_the_joint_slows(kd):
    """Moved to where the torque just keeps its limit, the target pushed with 36 and 561 Nm once the joint was slow."""
    moving = with_joint("joint_vel_rad_s", 4.0)
    wish = Wish(moving.joint_pos_rad, ROBOT.kp, np.full(JOINTS, kd))
    command = Guard(ROBOT, SETTINGS, PERIOD_S).command(wish, moving)
    for speed_rad_s in (4.0, 2.0, 0.5, 0.0):
        assert true_nm(command, with_joint("joint_vel_rad_s", speed_rad_s))[KNEE] == -kd * speed_rad_s


def test_what_is_not_believed_is_late_and_its_target_held():
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    truth, held = state(), ROBOT.default_pos_rad + 0.01
    guard.command(Wish(held, ROBOT.kp, ROBOT.kd), guard.believed(truth))
    seen = guard.believed(lie(replace(truth, time_s=PERIOD_S), KNEE, 0.5, 0.0))
    command = guard.command(Wish(held + 0.02, ROBOT.kp, ROBOT.kd), seen)
    assert command.q_rad[KNEE] == held[KNEE] and command.q_rad[KNEE + 1] == held[KNEE + 1] + 0.02


@pytest.mark.parametrize(("wrong", "tick"), [([1, 2], None), ([1, 2, 4, 5], None), ([1, 2, 3], 3)])
def test_three_in_a_row_trip(wrong, tick):
    guard, tripped = Guard(ROBOT, SETTINGS, PERIOD_S), None
    for now in range(8):
        truth = state(time_s=now * PERIOD_S)
        seen = guard.believed(lie(truth, KNEE, 2.0, 0.0) if now in wrong else truth)
        fault = guard.check(make_sample(seen), moving=True)
        if fault is not None:
            tripped = now
            assert fault.rule == "implausible" and "left_knee_joint goes from 0.30 to 2.30 rad" in fault.detail
            break
    assert tripped == tick


@pytest.mark.parametrize("jump_rad", [0.31, 0.5, 1.0])
def test_a_zero_that_is_lost_while_running_trips_and_is_the_truth_at_rest(jump_rad):
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    for now in range(2):
        guard.believed(state(time_s=now * PERIOD_S))
    readings = [lie(state(time_s=now * PERIOD_S), WAIST, jump_rad, 0.0) for now in range(2, 6)]
    faults = [guard.check(make_sample(guard.believed(reading)), moving=True) for reading in readings[:3]]
    assert faults[:2] == [None, None] and faults[2].rule == "implausible"
    guard.reset()
    assert guard.believed(readings[3]) is readings[3]


def test_the_fastest_movement_is_believed():
    """From rest to the speed limit and back within five ticks each, at the largest speed that a motor allows."""
    guard, pos_rad, speed_rad_s = Guard(ROBOT, SETTINGS, PERIOD_S), ROBOT.default_pos_rad.copy(), np.zeros(JOINTS)
    shares = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 0.8, 0.6, 0.4, 0.2, 0.0, 0.0]
    for tick, share in enumerate(shares):
        before, speed_rad_s = speed_rad_s, share * ROBOT.vel_limit_rad_s
        pos_rad = pos_rad + 0.5 * (before + speed_rad_s) * PERIOD_S
        moved = state(time_s=tick * PERIOD_S, joint_pos_rad=pos_rad, joint_vel_rad_s=speed_rad_s)
        assert guard.believed(moved) is moved


@pytest.mark.parametrize("stopped_after", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_a_landing_that_stops_a_joint_between_two_samples_is_believed(stopped_after):
    """At nine tenths of its limit until then, at rest from then on: how far it got is not what both speeds say."""
    guard, truth = Guard(ROBOT, SETTINGS, PERIOD_S), state()
    speed_rad_s = 0.9 * ROBOT.vel_limit_rad_s[KNEE]
    moved_rad = speed_rad_s * PERIOD_S * np.array([-1.0, 0.0, stopped_after, stopped_after])
    for tick, (further_rad, now_rad_s) in enumerate(zip(moved_rad, (speed_rad_s, speed_rad_s, 0.0, 0.0))):
        moved = lie(replace(truth, time_s=tick * PERIOD_S), KNEE, further_rad, now_rad_s)
        assert guard.believed(moved) is moved


class LyingBackend(MujocoBackend):
    """Every half second one reading is wrong, each time in the next way.

    pushes_nm: the largest ones, of each joint where it truly is.
    """

    ways = ()
    readings = 0
    pushes_nm = 0.0

    def read(self):
        self.readings += 1
        reading = self.truth = super().read()
        if not self.ways or self.readings % 25:
            return reading
        wrong = self.ways[self.readings // 25 % len(self.ways)]
        return lie(reading, wrong[0], *wrong[2:])

    def write(self, command):
        self.pushes_nm = np.maximum(self.pushes_nm, np.abs(true_nm(command, self.truth)))
        super().write(command)


def stands(ways, duration_s):
    clock, actor = SimulatedClock(), bundled_run("stand")
    cell = Cell(ROBOT, SETTINGS, [actor])
    with LyingBackend(ROBOT, clock, load_sim_options("default"), gantry=False) as backend:
        place_at_reference(backend, actor, 0.0, np.random.default_rng(0))
        backend.ways = ways
        cell.loop(backend, clock, plan=cell.start_tracking(), duration_s=duration_s).run()
        return cell, backend.pushes_nm, backend.data.qpos[2]


def test_standing_goes_on_through_all_of_them():
    """Twice each."""
    _, usual_nm, _ = stands((), 3.0)
    cell, pushes_nm, height_m = stands(tuple(WRONG.values()), 8.2)
    assert cell.machine.fault is None and height_m > 0.75
    assert cell.guard.counts["implausible"] == 2 * len(WRONG)
    assert (pushes_nm <= 1.3 * usual_nm + 2.0).all(), pushes_nm - usual_nm
