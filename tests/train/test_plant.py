"""The nominal robot as a discrete system, beside MuJoCo's own steps and derivatives."""

import mujoco
import numpy as np
import pytest

from robot.robot import Robot
from tests.train.worlds import g1
from train.priors.plant import SUBSTEP_S, WRENCH_UNIT, Motion, PriorPlant, difference, joined, moved
from world.model import compile_model

SUBSTEPS = 4


@pytest.fixture(scope="module")
def robot() -> Robot:
    return g1()


def model_of(robot: Robot) -> mujoco.MjModel:
    return compile_model(robot, timestep_s=SUBSTEP_S, actuation="pd_position", strip_visuals=True)


def airborne(robot: Robot, ticks: int, wrench: np.ndarray) -> Motion:
    """The default pose, falling from far above the ground, made by MuJoCo itself."""
    model = model_of(robot)
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[3:7], data.qpos[7:] = [0.0, 0.0, 5.0], [1.0, 0.0, 0.0, 0.0], robot.default_pos_rad
    data.qfrc_applied[:6] = wrench * WRENCH_UNIT
    qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
    for _ in range(ticks):
        data.ctrl[:] = robot.default_pos_rad
        mujoco.mj_step(model, data, SUBSTEPS)
        qpos.append(data.qpos.copy())
        qvel.append(data.qvel.copy())
    return Motion(np.array(qpos), np.array(qvel), np.tile(np.concatenate([robot.default_pos_rad, wrench]), (ticks, 1)))


def test_a_tick_is_mujocos(robot):
    made = airborne(robot, 3, np.array([0.5, -0.2, 1.0, 0.1, 0.0, -0.1]))
    qpos, qvel = PriorPlant(robot, SUBSTEPS, 2).advance(made.qpos[:-1], made.qvel[:-1], made.command)
    assert qpos == pytest.approx(made.qpos[1:], abs=1e-9)
    assert qvel == pytest.approx(made.qvel[1:], abs=1e-8)


def test_slopes_are_mujocos_where_nothing_touches(robot):
    """Beside products of mjd_transitionFD, whose differences are narrow; in the air both must be the same slope."""
    model = model_of(robot)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.actuator_forcelimited[:] = 0
    made = airborne(robot, 1, np.zeros(6))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = made.qpos[0], made.qvel[0], made.command[0, : model.nu]
    state, control = np.eye(2 * model.nv), np.zeros((2 * model.nv, model.nu))
    for _ in range(SUBSTEPS):
        a, b = np.empty((2 * model.nv, 2 * model.nv)), np.empty((2 * model.nv, model.nu))
        mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
        state, control = a @ state, a @ control + b
        mujoco.mj_step(model, data)
    slopes = PriorPlant(robot, SUBSTEPS, 2).linearize(made)
    assert np.abs(slopes.state[0] - state).max() < 0.02 * np.abs(state).max()
    assert np.abs(slopes.command[0, :, : model.nu] - control).max() < 0.02 * np.abs(control).max()


def test_a_gap_is_what_a_tick_misses_the_next_state_by(robot):
    made = airborne(robot, 4, np.zeros(6))
    shift = np.zeros(made.qvel.shape[1])
    shift[[1, 4, 9]] = 0.02, -0.1, 0.05
    broken = made.qpos.copy()
    broken[-1] = moved(broken[-1], shift)
    gap = PriorPlant(robot, SUBSTEPS, 2).linearize(Motion(broken, made.qvel, made.command)).gap
    assert gap[:-1] == pytest.approx(0.0, abs=1e-5)
    assert gap[-1, : len(shift)] == pytest.approx(-shift, abs=1e-5)


def test_parts_join_to_the_whole(robot):
    made = airborne(robot, 5, np.zeros(6))
    again = joined([made.part(0, 2), made.part(2, 2), made.part(2, 5)])
    for name in ("qpos", "qvel", "command"):
        assert getattr(again, name) == pytest.approx(getattr(made, name), abs=0)


def test_the_helper_force_is_in_newtons_per_axis(robot):
    made = airborne(robot, 2, np.array([0.3, -0.6, 0.0, 9.0, 9.0, 9.0]))
    assert made.helper_force_n() == pytest.approx([30.0, 30.0])


def test_tangents_are_those_of_mujoco(robot):
    """Moving and taking differences of configurations agree with mj_integratePos and mj_differentiatePos."""
    model = model_of(robot)
    rng = np.random.default_rng(1)
    qpos, tangent = rng.normal(size=model.nq), rng.normal(size=model.nv)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    expected, back = qpos.copy(), np.empty(model.nv)
    mujoco.mj_integratePos(model, expected, tangent, 1.0)
    assert moved(qpos, tangent) == pytest.approx(expected, abs=1e-12)
    mujoco.mj_differentiatePos(model, back, 1.0, qpos, expected)
    assert difference(expected, qpos) == pytest.approx(back, abs=1e-9)
