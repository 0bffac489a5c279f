"""The fitted estimate: against least squares by another way, and against the truth in a play that it has not seen."""

import numpy as np
import pytest
import torch

from motion.library import open_motion
from motion.reference import build_reference
from tests.train.worlds import g1, settings
from train.export import to_onnx, verify
from train.learner.networks import ActorNetwork, Mlp
from train.mdp.factory import build_environment
from train.priors import fitting
from train.priors.fitting import fit_estimate, ridge
from train.priors.module import PriorSettings, build_prior

NOISE = {"base_ang_vel": 0.3, "projected_gravity": 0.2, "dof_pos": 0.01, "dof_vel": 1.0}
BLOCKS = ((6, 8), (10, 13, 16))


def test_ridge_is_least_squares_with_a_penalty_relative_to_each_clue():
    """Rows that stand for the penalty, appended, make it ordinary least squares."""
    rng = np.random.default_rng(0)
    clues = rng.normal(size=(50, 3)) * [1.0, 10.0, 0.1]
    errors = clues @ rng.normal(size=(3, 2)) + 0.1 * rng.normal(size=(50, 2))
    size = np.sqrt((clues**2).mean(axis=0))
    rows = np.vstack([clues, np.sqrt(fitting.RIDGE * 50) * np.diag(size)])
    expected = np.linalg.lstsq(rows, np.vstack([errors, np.zeros((3, 2))]), rcond=None)[0]
    got = ridge(torch.tensor(clues).float(), torch.tensor(errors).float())
    assert got.numpy() == pytest.approx(expected, rel=1e-3)


def test_a_clue_that_is_never_there_gets_no_weight():
    clues = torch.cat([torch.linspace(-1.0, 1.0, 20)[:, None], torch.zeros(20, 1)], dim=1)
    weights = ridge(clues, 2.0 * clues[:, :1])
    assert weights[:, 0].tolist() == pytest.approx([2.0 / (1.0 + fitting.RIDGE), 0.0], abs=1e-4)


@pytest.fixture(scope="module")
def fitted():
    robot = g1()
    reference = build_reference(open_motion("stand", robot), robot)
    rule = {"terms": {"tilt": {"limit": 0.75}, "height": {"min_m": 0.5}}}
    world = settings(observation_noise=NOISE, termination=rule, older_lags=BLOCKS)
    base = build_prior(PriorSettings(features=True), robot, reference, 0.25, older_lags=BLOCKS)
    lines: list[str] = []
    fit_estimate(base, world, robot, reference, num_envs=48, seed=5, threads=2, noise_std=0.1, progress=lines.append)
    return robot, reference, world, base, lines


def test_it_knows_the_state_better_than_the_averages_do(fitted):
    """In another play, judged by MuJoCo's own state: gravity, gyro and the joints' speeds."""
    robot, reference, world, base, lines = fitted
    env = build_environment(world, robot, reference, num_envs=32, seed=77, threads=2)
    observations, squares = env.reset()["actor"], []
    for tick in range(60):
        observations = env.step(base(observations)).observations["actor"]
        if tick < 10:
            continue
        state, phase = env.simulator.state(), base.phase(observations)
        w, x, y, z = state.root_quat_wxyz.T
        gravity = -torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1)
        truth = torch.cat([gravity, state.root_ang_vel_b, state.joint_vel_rad_s], dim=1)
        averages, _, _ = base.deviation.parts(observations, phase)
        estimate = base.deviation(observations, phase)[0][:, : averages.shape[1]]
        wanted = torch.tensor([0.0, 0.0, -1.0] + [0.0] * 26)  # the stand does not move
        columns = [*range(6), *range(29, 52)]
        squares.append(torch.stack([(known[:, columns] + wanted - truth).square() for known in (averages, estimate)]))
    before, after = torch.stack(squares).mean(dim=(0, 2))
    for part in (slice(0, 2), slice(3, 6), slice(6, 29)):
        assert float(after[part].mean()) < 0.6 * float(before[part].mean())
    assert len(lines) == fitting.ROUNDS and "round 2 of 2" in lines[-1]


def test_same_seed_same_estimate(fitted):
    robot, reference, world, base, _ = fitted
    again = build_prior(PriorSettings(features=True), robot, reference, 0.25, older_lags=BLOCKS)
    fit_estimate(
        again, world, robot, reference, num_envs=48, seed=5, threads=1, noise_std=0.1, progress=lambda line: None
    )
    assert torch.equal(again.deviation.correction, base.deviation.correction)


def test_it_is_exported_with_the_actor(fitted):
    _, _, _, base, _ = fitted
    assert base.deviation.correction.abs().max() > 0.01
    mlp = Mlp(380 + base.inputs, (16,), 23, activation="silu", generator=torch.Generator().manual_seed(0))
    actor = ActorNetwork(mlp, 23, (0.2, 0.01, 1.0), base).deployed()
    assert verify(actor, to_onnx(actor, "obs"), "obs") <= 1e-5
    assert any("correction" in name for name in actor.state_dict())
