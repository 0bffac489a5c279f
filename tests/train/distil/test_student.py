"""The student on the real environment: what it may not see, what it does with nothing, what is exported of it."""

import numpy as np
import onnxruntime
import pytest
import torch

from motion.library import open_motion
from policy.actor import resolve_actor
from policy.goals import KINDS
from policy.layouts import goals_actor_group, tracker_actor_group
from policy.metadata import read_metadata
from robot.robot import load_robot
from tests.train.distil.small import small
from tests.train.test_many_clips import environment
from tests.train.world_model.small import iterate
from train.config import check, compose_document
from train.distil.build import build_distil_learner, goal_columns
from train.distil.normalizer import RunningNormalizer
from train.export import actor_spec, export_actor
from train.lineage import find_source

ROBOT = load_robot()
MEASURED = 546  # five ticks and two means of 3 + 3 + 23 + 23 + 23 + 3


@pytest.fixture(scope="module")
def trained():
    """Environment, learner and last observations after two iterations."""
    env, learner = small()
    observations, _ = iterate(env, learner, env.reset(), 2)
    return env, learner, observations


def teacher_weights():
    return find_source("tracker", ROBOT, tracker_actor_group(), where="teacher").networks["actor"]


def test_the_teacher_is_the_bundled_actor_in_batches(trained):
    _, learner, observations = trained
    graph = onnxruntime.InferenceSession(str(resolve_actor("tracker")))
    wanted = np.concatenate([
        graph.run(["action"], {"actor_obs": row[None].numpy()})[0] for row in observations["teacher"]
    ])  # fmt: skip
    assert learner.teacher(observations["teacher"]).numpy() == pytest.approx(wanted, abs=1e-4)


def test_the_teacher_sees_what_the_robot_measures_with_the_same_noise(trained):
    _, _, observations = trained
    assert torch.equal(observations["actor"][:, :MEASURED], observations["teacher"][:, :MEASURED])


def test_the_teacher_sees_what_a_tracker_would_see_there_whatever_is_hidden():
    """Without noise, against an environment that has the tracker as its actor."""
    kinds = {kind: 0.0 for kind in KINDS} | {"none": 1.0}
    alike = {"start": {"first_frame": 1.0}, "clips": {"in_turn": True}}
    taught = environment(observations="goals", teacher="tracker", goals={"kinds": kinds}, **alike)
    tracking = environment(observations="tracker", **alike)
    generator = torch.Generator().manual_seed(1)
    seen, wanted = taught.reset(), tracking.reset()
    for _ in range(3):
        assert torch.equal(seen["teacher"], wanted["actor"])
        assert not seen["actor"][:, MEASURED:].any() and wanted["actor"][:, MEASURED:].any(dim=1).all()
        action = 0.05 * torch.randn(6, 23, generator=generator)
        seen, wanted = (env.step(action).observations for env in (taught, tracking))


def test_columns_of_the_goal_are_those_that_look_ahead():
    """The tracker's: one error of each joint, a heading, eight rows of joints, two more, seven times ten numbers."""
    columns = goal_columns(tracker_actor_group(), 23)
    assert columns.tolist() == [*range(MEASURED, 871)]
    assert len(goal_columns(goals_actor_group(), 23)) == 996 - MEASURED


def test_a_hidden_value_changes_no_bit_of_what_the_deployed_student_does(trained):
    """Whatever the teacher sees; with the encoder it does."""
    _, learner, observations = trained
    other = {**observations, "teacher": torch.randn_like(observations["teacher"])}
    student, noise = learner.student, torch.zeros(8, 6)
    deployed, informed = (
        [student.act(way, student.look(seen), noise) for seen in (observations, other)] for way in student.ways
    )
    assert torch.equal(*deployed) and torch.equal(deployed[0], student.actor(observations["actor"]))
    assert (informed[0] - informed[1]).abs().amax(dim=1).min() > 0.0


def test_with_everything_hidden_actions_and_losses_are_finite():
    others = ",".join(f"{kind}:0.0" for kind in (*KINDS, "random") if kind != "none")
    env, learner = small(f"environment.goals.kinds={{none:1.0,{others}}}", "environment.goals.redraw_per_s=5.0")
    observations, rows = iterate(env, learner, env.reset(), 3)
    assert not observations["actor"][:, MEASURED:].any()
    assert all(np.isfinite(value) for row in rows for value in row.values())
    nothing = {"actor": torch.zeros(3, 996), "teacher": torch.zeros(3, 871)}
    for way in learner.student.ways:
        assert torch.isfinite(learner.student.act(way, learner.student.look(nothing), torch.zeros(3, 6))).all()


def test_latent_noise_is_that_of_the_episode_while_acting(trained):
    """It changes for robots whose episode ends, and for no other."""
    env, learner, observations = trained
    before = learner._noise.clone()
    result = env.step(learner.act(observations))
    ended = torch.tensor([True, False] * 4)
    result = type(result)(**{**vars(result), "terminated": ended, "timed_out": torch.zeros_like(ended)})
    learner.record(result)
    assert ((learner._noise != before).all(dim=1) == ended).all()


def recorded(student):
    """The samples that the student is asked to predict from now on."""
    used, predict = [], student.predict

    def predicted(samples):
        used.append(samples)
        return predict(samples)

    student.predict = predicted
    return used


def test_noise_of_the_episode_or_fresh_while_learning():
    learnt = {}
    for kind in ("episode", "fresh"):
        env, learner = small(f"distil.noise={kind}")
        used, predict = [], learner.student.predict
        learner.student.predict = lambda samples, used=used, predict=predict: (used.append(samples), predict(samples))[
            1
        ]
        iterate(env, learner, env.reset(), 1)
        known = {tuple(row) for row in learner.buffer.newest(64)["noise"].tolist()}
        learnt[kind] = {tuple(row) in known for samples in used for row in samples["noise"].tolist()}
    assert learnt == {"episode": {True}, "fresh": {False}}


def test_the_loss_falls_on_what_is_seen():
    env, learner = small(
        "distil.capacity=1024", "distil.batch=32", "distil.updates=8", "distil.student.prior_hidden=[64]",
        "distil.student.encoder_hidden=[64]", "distil.student.decoder_hidden=[64]",
    )  # fmt: skip
    _, rows = iterate(env, learner, env.reset(), 20)
    first, last = (sum(row["distil/action"] for row in part) / 5 for part in (rows[:5], rows[-5:]))
    assert last < 0.6 * first


def test_the_file_computes_the_deployed_student(trained, tmp_path):
    env, learner, observations = trained
    actor, clip = learner.actor_with(learner.weights), open_motion("side_kick", ROBOT)
    export_actor(
        actor, actor_spec(ROBOT, clip, "side_kick", {}, env.actor_group, any_clip=True), clip, tmp_path / "actor.onnx"
    )
    spec, graph = read_metadata(tmp_path / "actor.onnx").spec, onnxruntime.InferenceSession(tmp_path / "actor.onnx")
    assert spec.follows == "any_clip" and spec.observations == (goals_actor_group(),)
    got = [graph.run(["action"], {"actor_obs": row[None].numpy()})[0][0] for row in observations["actor"]]
    assert np.stack(got) == pytest.approx(actor(observations["actor"]).detach().numpy(), abs=1e-5)


def test_a_learner_makes_no_tensor_on_the_default_device():
    """Which here has no numbers; the same experience gives the same figures."""
    env, learner = small("distil.noise=fresh")
    _, other = small("distil.noise=fresh")
    observations, rows = env.reset(), []
    for _ in range(3):
        for _ in range(learner.horizon):
            action = learner.act(observations)
            with torch.device("meta"):
                assert torch.equal(other.act(observations), action)
            result = env.step(action)
            learner.record(result)
            with torch.device("meta"):
                other.record(result)
            observations = result.observations
        rows.append(learner.update(observations))
        with torch.device("meta"):
            assert other.update(observations) == rows[-1]
            other.load_state_dict(other.state_dict())


def full_size(preset, *overrides):
    small_memory = ["num_envs=16", "distil.capacity=512", "distil.batch=512", "distil.steps=32"]
    config = check(compose_document(["motion=side_kick", f"train={preset}", *small_memory, *overrides]))
    return build_distil_learner(config, ROBOT, teacher_weights())


@pytest.mark.parametrize("preset", ["maskedmimic", "maskedmimic_paper"])
def test_what_is_deployed_is_small(preset):
    deployed = full_size(preset).student.actor
    assert sum(parameter.numel() for parameter in deployed.parameters()) <= 2_000_000


@pytest.mark.parametrize(("precision", "megabytes"), [("bf16", (2.7, 2.9)), ("fp32", (5.4, 5.8))])
def test_what_bf16_trained_is_stored_in_half_the_bytes(trained, tmp_path, precision, megabytes):
    """The stored one is off the trained weights, and by less than training's own products are."""
    env, _, observations = trained
    learner = full_size("maskedmimic", f"precision={precision}")
    actor, clip, path = learner.actor_with(learner.weights), open_motion("side_kick", ROBOT), tmp_path / "actor.onnx"
    export_actor(actor, actor_spec(ROBOT, clip, "side_kick", {}, env.actor_group, any_clip=True), clip, path)
    assert megabytes[0] < path.stat().st_size / 1e6 < megabytes[1]
    graph = onnxruntime.InferenceSession(path)
    got = np.concatenate([graph.run(["action"], {"actor_obs": row[None].numpy()})[0] for row in observations["actor"]])
    with torch.no_grad():
        wanted, learning = (each(observations["actor"]).numpy() for each in (actor, learner.student.actor))
    if precision == "fp32":
        assert got == pytest.approx(wanted, abs=1e-5)
    else:
        assert 0.0 < np.abs(got - wanted).mean() < 0.25 * np.abs(learning - wanted).mean()


def test_running_mean_and_spread_are_those_of_all_that_was_seen():
    seen = 3.0 + 2.0 * torch.randn(1000, 3, generator=torch.Generator().manual_seed(0))
    seen[:, 2] = 7.0
    normalizer = RunningNormalizer(3)
    for part in seen.split([1, 99, 500, 400]):
        normalizer.update(part)
    assert normalizer.mean.numpy() == pytest.approx(seen.numpy().mean(axis=0), rel=1e-5)
    assert normalizer.variance.sqrt().numpy() == pytest.approx(seen.numpy().std(axis=0), rel=1e-4, abs=1e-3)
    assert normalizer(torch.tensor([[1e9, -1e9, 7.01]]))[0].tolist() == pytest.approx([12.0, -12.0, 0.5], abs=1e-3)
