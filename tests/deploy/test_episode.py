"""Episodes as the evaluation plays them; from the first frame, from the gantry, to a fall."""

from dataclasses import replace

import numpy as np
import pytest

from core.clock import SimulatedClock
from core.errors import InputError
from deploy.actors import load_run
from deploy.episode import EpisodeRig, Start, run_episode
from hal.open import open_backend
from motion.metrics import METRIC_KEYS
from sim2sim.player import score_of
from tests.deploy.toys import ROBOT, SETTINGS, linear_run, write_standing_actor
from tests.shared_data import SHARED, needs_shared_data

KINEMATICS = ROBOT.kinematics


def rig(backend, clock, actor, **options):
    return EpisodeRig(ROBOT, KINEMATICS, SETTINGS, backend, clock, actor, **options)


@pytest.fixture(scope="module")
def stand(tmp_path_factory):
    path = write_standing_actor(tmp_path_factory.mktemp("stand") / "stand.onnx")
    return load_run(path, None, ROBOT, SETTINGS.entry)


def test_reference_start_is_the_first_frame_at_rest_and_the_seed_decides(stand):
    clock = SimulatedClock()
    first = []

    def watch(state, result, timer):
        if not first or first[-1] is None:
            first.append(state)

    with open_backend("mujoco", ROBOT, clock, gantry=False) as backend:
        stage = rig(backend, clock, stand)
        exact = run_episode(stage, np.random.default_rng(0), observers=[watch])
        results = [run_episode(stage, np.random.default_rng(seed), start_noise_rad=0.02) for seed in (1, 1, 2)]
    np.testing.assert_allclose(first[0].truth.joint_pos_rad, stand.reference.joint_pos_rad[0], atol=1e-12)
    np.testing.assert_array_equal(first[0].truth.joint_vel_rad_s, 0.0)
    assert exact.outcome == "completed" and exact.steps == exact.num_ticks == 50 and not exact.fell
    assert exact.track.body_pos_w.shape == exact.reference.body_pos_w.shape == (50, 27, 3)
    assert tuple(sorted(exact.metrics)) == tuple(sorted(METRIC_KEYS))
    assert results[0].metrics == results[1].metrics != results[2].metrics


def test_from_the_gantry_to_standing_again(stand):
    clock = SimulatedClock()
    with open_backend("mujoco", ROBOT, clock) as backend:
        result = run_episode(
            rig(backend, clock, stand, stand=stand), np.random.default_rng(3), start=Start.STAND, start_noise_rad=0.02
        )
        assert not backend.gantry_attached
    assert (result.outcome, result.fell, result.steps) == ("completed", False, 50)
    with pytest.raises(InputError, match="stand actor"):
        run_episode(rig(backend, clock, stand), np.random.default_rng(3), start=Start.STAND)


def test_a_fall_ends_the_episode_in_both_simulations(tmp_path):
    limp = linear_run(tmp_path, seconds=20.0)
    for sim in ("default", "reference"):
        clock = SimulatedClock()
        with open_backend("mujoco", ROBOT, clock, sim=sim, gantry=False) as backend:
            stage = rig(backend, clock, limp, report_only=sim == "reference")
            result = run_episode(stage, np.random.default_rng(0), start_noise_rad=0.02)
        assert result.fell and result.outcome in ("fell", "tripped")
        assert result.steps < result.num_ticks
        assert result.metrics["episode_length_ratio"] == result.steps / result.num_ticks


def test_a_trip_ends_an_episode_where_limits_only_report_as_well(stand):
    safety = replace(SETTINGS.safety, tilt=replace(SETTINGS.safety.tilt, away_rad=1e-4))
    clock = SimulatedClock()
    with open_backend("mujoco", ROBOT, clock, sim="reference", gantry=False) as backend:
        stage = replace(rig(backend, clock, stand, report_only=True), settings=replace(SETTINGS, safety=safety))
        result = run_episode(stage, np.random.default_rng(0), start_noise_rad=0.02)
    assert (result.outcome, result.fell, result.steps) == ("tripped", True, 3)  # 0.06 s
    assert score_of(result, ROBOT, None).ended == "tilt"


@needs_shared_data
def test_a_motion_that_the_actor_needs_and_does_not_carry():
    policy = SHARED / "pbhc" / "actor_horse_stance_pose" / "model_50000.onnx"
    with pytest.raises(InputError, match="--motion"):
        load_run(policy, None, ROBOT, SETTINGS.entry)
