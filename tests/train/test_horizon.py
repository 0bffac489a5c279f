"""The Riccati recursion beside dense least squares and SciPy, and passes that find or lose the robot."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from motion.inverse_dynamics import generalized_motion
from tests.train.worlds import g1, swaying_reference
from train.priors.horizon import Objective, Policy, Value, backward, follow
from train.priors.plant import LINEARIZE_EVERY, Motion, PriorPlant, Slopes

NV, COMMANDS = 7, 7  # a root with one joint


def still(ticks: int, command: np.ndarray) -> Motion:
    qpos = np.zeros((ticks + 1, NV + 1))
    qpos[:, 3] = 1.0
    return Motion(qpos, np.zeros((ticks + 1, NV)), command)


def linear_system(ticks: int, seed: int) -> Slopes:
    rng = np.random.default_rng(seed)
    knots = -(-ticks // LINEARIZE_EVERY)
    states = np.eye(2 * NV) + 0.1 * rng.normal(size=(knots, 2 * NV, 2 * NV))
    return Slopes(states, rng.normal(size=(knots, 2 * NV, COMMANDS)), 0.1 * rng.normal(size=(ticks, 2 * NV)))


def led(slopes: Slopes, policy: Policy, ticks: int) -> np.ndarray:
    """Changes of the commands (T, J+6) when the linear system is led by the policy from its first state."""
    deviation, changes = np.zeros(2 * NV), []
    for tick in range(ticks):
        changes.append(-policy.correction[tick] - policy.feedback[tick] @ deviation)
        knot = tick // LINEARIZE_EVERY
        deviation = slopes.state[knot] @ deviation + slopes.command[knot] @ changes[-1] + slopes.gap[tick]
    return np.array(changes)


def test_the_correction_is_the_least_squares_solution():
    """All commands at once, by numpy.linalg.lstsq: the cheapest of a linear system with gaps."""
    ticks, rng = 6, np.random.default_rng(2)
    slopes, motion = linear_system(ticks, 1), still(6, rng.normal(size=(6, COMMANDS)))
    wanted = still(ticks, rng.normal(size=(ticks, COMMANDS)))
    objective = Objective(wanted, rng.uniform(0.5, 2.0, 2 * NV), rng.uniform(0.5, 2.0, COMMANDS))
    found = led(slopes, backward(slopes, motion, objective, objective.end()), ticks)

    # Every state as a linear function of all commands' changes; unknowns stacked.
    effect, offset = np.zeros((2 * NV, ticks * COMMANDS)), np.zeros(2 * NV)
    rows, wants = [], []
    for tick in range(ticks):
        knot = tick // LINEARIZE_EVERY
        effect, offset = slopes.state[knot] @ effect, slopes.state[knot] @ offset + slopes.gap[tick]
        effect[:, tick * COMMANDS : (tick + 1) * COMMANDS] += slopes.command[knot]
        rows.append(np.sqrt(objective.state)[:, None] * effect)
        wants.append(-np.sqrt(objective.state) * offset)
    price = np.sqrt(np.tile(objective.command, ticks))
    rows.append(np.diag(price))
    wants.append(price * (wanted.command - motion.command).ravel())
    expected, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(wants), rcond=None)
    assert found.ravel() == pytest.approx(expected, abs=1e-8)


def test_far_from_the_end_the_feedback_is_scipys():
    ticks, rng = 400, np.random.default_rng(3)
    a = np.eye(2 * NV) + 0.05 * rng.normal(size=(2 * NV, 2 * NV))
    b = rng.normal(size=(2 * NV, COMMANDS))
    knots = ticks // LINEARIZE_EVERY
    slopes = Slopes(np.tile(a, (knots, 1, 1)), np.tile(b, (knots, 1, 1)), np.zeros((ticks, 2 * NV)))
    motion = still(ticks, np.zeros((ticks, COMMANDS)))
    objective = Objective(motion, rng.uniform(0.5, 2.0, 2 * NV), rng.uniform(0.5, 2.0, COMMANDS))
    policy = backward(slopes, motion, objective, objective.end())
    cost_to_go = solve_discrete_are(a, b, np.diag(objective.state), np.diag(objective.command))
    gain = np.linalg.solve(np.diag(objective.command) + b.T @ cost_to_go @ b, b.T @ cost_to_go @ a)
    assert policy.curvature[0] == pytest.approx(cost_to_go, rel=1e-6, abs=1e-6)
    assert policy.feedback[0] == pytest.approx(gain, rel=1e-6, abs=1e-6)


def test_a_cost_to_go_is_the_same_from_wherever_it_is_written():
    rng = np.random.default_rng(4)
    half = rng.normal(size=(2 * NV, 2 * NV))
    motion = still(1, np.zeros((1, COMMANDS)))
    value = Value(motion.qpos[0], motion.qvel[0], half @ half.T, rng.normal(size=2 * NV))
    motion.qpos[-1, 0], motion.qvel[-1, 3] = 0.3, -0.2
    deviation = np.zeros(2 * NV)
    deviation[0], deviation[NV + 3] = 0.3, -0.2
    assert value.cost(motion) == pytest.approx(0.5 * deviation @ value.curvature @ deviation + value.slope @ deviation)


def test_physics_that_diverged_costs_infinitely_much():
    wanted = still(2, np.zeros((2, COMMANDS)))
    objective = Objective(wanted, np.ones(2 * NV), np.ones(COMMANDS))
    rates = wanted.qvel.copy()
    for broken in (np.nan, 1e6):
        rates[1, 2] = broken
        assert objective.cost(Motion(wanted.qpos, rates, wanted.command), objective.end()) == np.inf


def test_whoever_cannot_follow_is_lost():
    """The wanted motion rises a metre in half a second; the robot has no wrench to speak of, and is left behind."""
    robot = g1()
    qpos, qvel, _ = generalized_motion(swaying_reference(robot, 0.5))
    qpos[:, 2] += np.linspace(0.0, 1.0, len(qpos))
    command = np.hstack([qpos[:-1, 7:], np.zeros((len(qpos) - 1, 6))])
    wanted = Motion(qpos, qvel, command)
    weights = np.ones(2 * qvel.shape[1]), np.concatenate([np.full(qpos.shape[1] - 7, 10.0), np.full(6, 1e6)])
    assert follow(PriorPlant(robot, 4, 2), Objective(wanted, *weights), wanted, 4) is None
