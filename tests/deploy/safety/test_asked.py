"""Lean, turn and joint speed are judged against what the clip asks for now, and no clip may ask for everything."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from core.clock import SimulatedClock
from deploy.actors import load_run
from deploy.cell import Cell
from deploy.control.tick import Tick
from deploy.episode import place_at_reference
from deploy.goals.clip import asked_by
from deploy.safety.guard import Guard
from deploy.safety.rules import Asked, make_sample
from hal.simulated.mujoco import MujocoBackend
from motion.reference import build_reference
from tests.deploy.toys import (
    JOINTS,
    KNEE,
    PERIOD_S,
    ROBOT,
    SETTINGS,
    bundled_run,
    state,
    still_clip,
    tilted,
    with_joint,
)
from world.options import load_sim_options

UP_B = np.array([0.0, 0.0, 1.0])
REST = Asked(UP_B, np.zeros(3), np.zeros(JOINTS))


def leaning(angle_rad):
    """A lean forward by this angle: up is behind the base's z."""
    return replace(REST, up_b=np.array([-np.sin(angle_rad), 0.0, np.cos(angle_rad)]))


def turning(*rate_b):
    return replace(REST, ang_vel_b=np.array(rate_b))


def bending(share):
    speeds = np.zeros(JOINTS)
    speeds[KNEE] = share * ROBOT.vel_limit_rad_s[KNEE]
    return replace(REST, joint_vel_rad_s=speeds)


def at_share(share):
    return with_joint("joint_vel_rad_s", share * ROBOT.vel_limit_rad_s[KNEE])


LEFT = Rotation.from_euler("z", 90, degrees=True) * Rotation.from_euler("y", 0.9)
CASES = [
    (state(imu_quat_wxyz=tilted(0.9)), leaning(0.9), None),
    (state(imu_quat_wxyz=tilted(0.9)), leaning(0.45), None),
    (state(imu_quat_wxyz=tilted(0.9)), leaning(0.3), "tilt"),
    (state(imu_quat_wxyz=tilted(0.9)), leaning(-0.9), "tilt"),
    (state(imu_quat_wxyz=tilted(0.9)), REST, "tilt"),
    (state(imu_quat_wxyz=tilted(0.9)), None, "tilt"),
    (state(imu_quat_wxyz=tilted(0.1)), leaning(0.9), None),  # it stays upright where it should lean: no danger
    (state(imu_quat_wxyz=tilted(1.31)), leaning(1.31), "tilt"),
    (state(imu_quat_wxyz=LEFT.as_quat(scalar_first=True)), leaning(0.9), None),  # the heading does not count
    (state(imu_ang_vel_b=np.array([0.0, 0.0, 8.0])), turning(0.0, 0.0, 3.1), None),
    (state(imu_ang_vel_b=np.array([0.0, 0.0, 8.0])), turning(0.0, 0.0, 2.9), "base_rate"),
    (state(imu_ang_vel_b=np.array([0.0, 7.0, 0.0])), turning(0.0, 0.0, 7.0), "base_rate"),
    (state(imu_ang_vel_b=np.array([0.0, 7.0, 0.0])), None, "base_rate"),
    (state(imu_ang_vel_b=np.array([0.0, 0.0, 2.0])), turning(0.0, 0.0, 9.0), None),
    (state(imu_ang_vel_b=np.array([0.0, 0.0, 12.1])), turning(0.0, 0.0, 12.1), "base_rate"),
    (at_share(0.9), bending(0.8), None),
    (at_share(0.9), bending(-0.8), "joint_speed"),
    (at_share(0.9), bending(0.1), "joint_speed"),
    (at_share(-0.9), None, "joint_speed"),
    (at_share(0.1), bending(0.9), None),
    (at_share(1.01), bending(1.01), "joint_speed"),
]


@pytest.mark.parametrize(("seen", "asked", "rule"), CASES)
def test_what_trips_beside_what_is_asked(seen, asked, rule):
    guard = Guard(ROBOT, SETTINGS, PERIOD_S)
    faults = [guard.check(make_sample(seen, asked=asked), moving=True) for _ in range(3)]
    assert faults[:2] == [None, None]
    assert (None if faults[2] is None else faults[2].rule) == rule


def test_what_a_clip_asks_is_what_mujoco_measures_of_it():
    """A clip that turns, leans and bends at once: gyroscope and gravity of a base that moves so."""
    clip, frames = still_clip(1.0), 51
    times_s = np.arange(frames) / 50.0
    turned = Rotation.from_euler("ZY", np.column_stack([2.0 * times_s, 0.8 * np.sin(3.0 * times_s)]))
    joints = clip.joint_pos_rad.copy()
    joints[:, KNEE] += 0.5 * np.sin(4.0 * times_s)
    clip = replace(clip, root_quat_wxyz=turned.as_quat(scalar_first=True), joint_pos_rad=joints)
    asked = asked_by(build_reference(clip, ROBOT, PERIOD_S))
    assert len(asked) == frames
    for k in (5, 20, 40):
        before, after = turned[k - 1].as_quat(scalar_first=True), turned[k + 1].as_quat(scalar_first=True)
        rate_b = np.zeros(3)
        mujoco.mju_subQuat(rate_b, after, before)
        np.testing.assert_allclose(asked[k].ang_vel_b, rate_b / 0.04, atol=0.03)
        np.testing.assert_allclose(asked[k].up_b, turned[k].inv().apply([0.0, 0.0, 1.0]), atol=1e-9)
        assert asked[k].joint_vel_rad_s[KNEE] == pytest.approx(2.0 * np.cos(4.0 * times_s[k]), abs=0.02)


def test_a_tick_judges_by_the_actor_that_moves_the_robot():
    """A lean of 0.6 rad is a fall while standing, and no fault in the tick of a clip that asks for 0.7."""
    stand = load_run("stand", None, ROBOT, SETTINGS.entry)
    cell = Cell(ROBOT, SETTINGS, [stand])
    cell.start_tracking()
    tick = Tick(cell.machine, cell.guard)
    seen = state(imu_quat_wxyz=tilted(0.6), joint_pos_rad=stand.start_pose_rad)
    stand.goals._asked = (leaning(0.7),) * (stand.num_ticks + 1)
    assert all(tick(replace(seen, time_s=now * PERIOD_S)).fault is None for now in range(5))
    stand.goals._asked = (REST,) * (stand.num_ticks + 1)
    faults = [tick(replace(seen, time_s=now * PERIOD_S)).fault for now in range(5, 8)]
    assert faults[:2] == [None, None] and faults[2].rule == "tilt"


def test_a_bundled_actor_still_trips_when_its_base_is_pushed_over():
    """Damped at once, so that the run ends where it trips."""
    clock, actor = SimulatedClock(), bundled_run("taichi")
    cell = Cell(ROBOT, replace(SETTINGS, bracing=None), [actor])
    with MujocoBackend(ROBOT, clock, load_sim_options("default"), gantry=False, scene=actor.scene) as backend:
        place_at_reference(backend, actor, 0.0, np.random.default_rng(0))
        plan = cell.start_tracking()
        backend.data.qvel[3:6] = (0.0, 9.0, 0.0)
        cell.loop(backend, clock, plan=plan, duration_s=2.0).run()
        assert cell.machine.fault is not None and cell.machine.fault.rule in ("tilt", "base_rate")
        assert backend.data.qpos[2] > 0.45
