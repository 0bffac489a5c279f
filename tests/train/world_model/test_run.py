"""A whole small run by the command's parts: trained, exported, played by the deployment's controller, begun from."""

import json
import shutil
from types import SimpleNamespace

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from core.errors import InputError
from deploy.actors import load_run
from deploy.settings import load_settings
from policy.actor import resolve_actor
from policy.metadata import read_metadata
from robot.robot import load_robot
from sim2sim.cli import main as evaluate
from tests.train.conftest import lightly
from tests.train.world_model.small import SMALL, WARM_UP
from tests.train.world_model.small import small as small_parts
from tests.train.worlds import beginning_of
from train.command import execute
from train.companion import read_companion
from train.lineage import find_source
from train.nan_guard import NonFiniteError
from train.report.preset import nearest_preset
from train.world_model import blindness

pytestmark = pytest.mark.usefixtures("light")
BEGUN = 20  # iterations of SMALL with another run's model, until its first round has ended


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """SMALL on the beginning of its clip: who ends is judged over the whole of it."""
    return [f"motion={beginning_of('side_kick', 0.5, tmp_path_factory.mktemp('clip'))}", *SMALL[1:]]


@pytest.fixture(autouse=True)
def few_steps(monkeypatch):
    """Once the actor is written, the model is compared on as few; the tracker's run has all of them."""
    monkeypatch.setattr(blindness, "STEPS", 10)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The run folder of a tracker. Of the runs here it alone has pictures, and physics on two threads."""
    folder = tmp_path_factory.mktemp("tracker")
    (folder / "clips").mkdir()
    beginning_of("side_kick", 0.5, folder / "clips")
    with lightly(pictures=True):
        execute([
            f"motions={folder / 'clips'}", *SMALL[1:], f"iterations={WARM_UP + 4}", "evaluate_every=null",
            "threads=2", f"run_dir={folder / 'run'}",
        ])  # fmt: skip
    return folder / "run"


def test_the_run_leaves_an_actor_of_any_clip_and_says_what_it_did(trained):
    summary = json.loads((trained / "summary.json").read_text())
    assert summary["outcome"] == "completed" and summary["iterations"] == WARM_UP + 4
    assert summary["blind_spots"] and all(spot["ratio"] > 0.0 for spot in summary["blind_spots"].values())
    rows = [json.loads(line) for line in (trained / "metrics.jsonl").read_text().splitlines()]
    assert "imagined/cost" in rows[-1] and "model/window_loss" in rows[-1]
    actor = load_run(trained / "actor.onnx", "taichi", load_robot(), load_settings().entry)
    assert actor.actor.spec.follows == "any_clip"
    assert np.abs(actor.reference.feedforward_rad).max() > 0.01


def test_its_weights_are_stored_in_half_precision_also_where_training_was_in_fp32(trained):
    graph = onnx.load(str(trained / "actor.onnx")).graph
    large = [weight for weight in graph.initializer if np.prod(weight.dims) >= 1000]
    assert len(large) == 3 and {weight.data_type for weight in large} == {onnx.TensorProto.FLOAT16}


def test_its_actor_plays_clips_it_never_saw(trained, tmp_path, capsys):
    clips = [str(beginning_of(name, 0.5, tmp_path)) for name in ("taichi", "stand")]
    assert evaluate(["--policy", str(trained / "actor.onnx"), "--motion", clips[0], "--motion", clips[1]]) == 0
    assert "completed %" in capsys.readouterr().out


def test_another_run_begins_with_its_policy_critic_and_model(small, trained, unjudged, tmp_path, capsys):
    """And learns in imagination as soon as it has collected: its model needs no warming up."""
    execute([
        *small, f"iterations={BEGUN}", "evaluate_every=null", f"init_from={trained}", f"run_dir={tmp_path / 'run'}",
    ])  # fmt: skip
    assert "weights of actor and critic and model" in capsys.readouterr().out
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    first = next(row["iteration"] for row in rows if "warm_up" not in row)
    assert first == BEGUN - 1 and "model/window_loss" in rows[first - 1] and "imagined/cost" in rows[-1]
    # An actor of one clip carries it.
    run = load_run(tmp_path / "run" / "actor.onnx", None, load_robot(), load_settings().entry)
    assert (run.actor.spec.follows, run.name) == ("clip", "side_kick")
    assert np.abs(run.reference.feedforward_rad).max() > 0.01
    # The learning rate falls over the updates that there are, from 5e-4 towards a tenth of it: of three the last one
    # has a cosine of 2/3 of the way, a quarter; in the tracker's run that of 5/6, of six.
    last = np.cos(np.pi * np.array([2 / 3, 5 / 6]))
    rates = [_learner(run)["policy"]["optimizer"]["param_groups"][0]["lr"] for run in (tmp_path / "run", trained)]
    assert rates == pytest.approx(5e-4 * (0.1 + 0.9 * (0.5 + 0.5 * last)))


def _learner(run_dir):
    """What the newest checkpoint knows of it."""
    return torch.load(sorted((run_dir / "checkpoints").glob("*.pt"))[-1], weights_only=True)["learner"]


def test_goals_are_learnt_with_a_trackers_model_and_played_by_kind(small, trained, tmp_path, capsys):
    """Its policy sees something else; the model is of the robot, whatever it is told to do."""
    execute([
        small[0], "train=goals", *SMALL[2:], f"iterations={BEGUN}", "evaluate_every=null",
        f"init_from={trained}", "init_networks=[model]", f"run_dir={tmp_path / 'run'}", "world_model.processes=1",
    ])  # fmt: skip
    assert "weights of model from" in capsys.readouterr().out
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert "imagined/cost" in rows[-1] and any(name.startswith("goal/") for name in rows[-1])
    clip = small[0].removeprefix("motion=")
    run = load_run(tmp_path / "run" / "actor.onnx", clip, load_robot(), load_settings().entry)
    assert run.reference.steering is not None
    sees = next(iter(run.act(_standing()).observation.values()))
    assert np.isfinite(sees).all() and len(sees) == _width(tmp_path / "run" / "actor.onnx")
    played = ["--policy", str(tmp_path / "run" / "actor.onnx"), "--motion", clip]
    assert evaluate([*played, "--goal", "vr3"]) == 0
    assert evaluate(["--policy", str(trained / "actor.onnx"), "--motion", clip, "--goal", "vr3"]) == 2
    assert "this actor follows clips, not goals" in capsys.readouterr().err


def _standing():
    robot = load_robot()
    return SimpleNamespace(
        imu_quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]), imu_ang_vel_b=np.zeros(3), joint_pos_rad=robot.default_pos_rad,
        joint_vel_rad_s=np.zeros(robot.num_joints),
    )  # fmt: skip


def test_a_network_that_a_source_lacks_is_refused(small, trained, tmp_path):
    alone = shutil.copy(trained / "actor.onnx", tmp_path / "actor.onnx")
    with pytest.raises(InputError, match="init_networks: not there, got model"):
        execute([*small, "init_networks=[model]", f"init_from={alone}", f"run_dir={tmp_path / 'run'}"])


def test_a_policy_of_another_shape_is_refused_by_name(small, trained, tmp_path):
    """Also where another process is what finds out."""
    with pytest.raises(InputError, match=r"the actor's weights do not fit, got mlp\.network\.first\.weight of"):
        execute([
            *small, "evaluate_every=null", f"init_from={trained}", f"run_dir={tmp_path / 'run'}",
            "world_model.policy.hidden=[16,16]",
        ])  # fmt: skip


def test_an_actors_companion_is_its_critic_and_its_world_model(small, trained, tmp_path):
    """To what half precision holds; it goes with no other actor."""
    learner = _learner(trained)
    digest = json.loads((trained / "summary.json").read_text())["actor_sha256"]
    read = read_companion(trained / "learner.npz", digest)
    wanted = {"critic": learner["critic"], "model": learner["fitting"]["model"]}
    assert read.keys() == wanted.keys()
    for name, weights in wanted.items():
        assert read[name].keys() == weights.keys()
        for key, value in weights.items():
            assert torch.allclose(read[name][key], value.float(), rtol=1e-3, atol=1e-6), key
    shutil.copy(trained / "learner.npz", tmp_path / "learner.npz")
    shutil.copy(resolve_actor("tracker"), tmp_path / "actor.onnx")
    with pytest.raises(InputError, match=r"learner\.npz: another actor's"):
        execute([*small, f"init_from={tmp_path / 'actor.onnx'}", f"run_dir={tmp_path / 'other'}"])
    (tmp_path / "learner.npz").write_bytes((trained / "learner.npz").read_bytes()[:500])
    with pytest.raises(InputError, match=r"learner\.npz: unreadable"):
        execute([*small, f"init_from={tmp_path / 'actor.onnx'}", f"run_dir={tmp_path / 'other'}"])


def test_another_run_begins_with_the_exported_policy_bit_by_bit(trained):
    """Graph weights are those of its average before its first update, normalisation included."""
    (env, learner), (_, other) = (small_parts("world_model.processes=1") for _ in range(2))
    networks = find_source(str(trained / "actor.onnx"), load_robot(), env.actor_group).networks
    assert learner.start_from(networks) == ["actor", "critic", "model"]
    assert other.start_from({name: networks[name] for name in ("actor", "model")}) == ["actor", "model"]  # an old file
    stored = {
        part.name: onnx.numpy_helper.to_array(part) for part in onnx.load(trained / "actor.onnx").graph.initializer
    }
    weights = learner.weights
    names = [name for name in weights if name.startswith("mlp.")]
    assert len(names) == 12
    for name in names:
        assert np.array_equal(weights[name].numpy(), stored[name]), name


def test_a_run_too_short_to_fit_a_model_of_its_own_needs_that_of_its_source(trained):
    """What the source has is known only now; a resumed run still knows whose model it was."""
    (env, learner), (_, resumed), (_, short) = (
        small_parts("world_model.processes=1", f"iterations={iterations}", "init_from=tracker")
        for iterations in (BEGUN + 2, BEGUN + 2, WARM_UP + 1)
    )
    networks = find_source(str(trained / "actor.onnx"), load_robot(), env.actor_group).networks
    learner.start_from(networks)
    resumed.load_state_dict(learner.state_dict())
    assert learner._rounds() == resumed._rounds() == 2  # of two iterations, after those that collect
    with pytest.raises(InputError, match="iterations: the policy would learn nothing, got 20, expected 21 or more"):
        short.start_from({"actor": networks["actor"]})


def test_clips_of_a_manifest_are_trained_together(tmp_path):
    manifest = tmp_path / "clips.yaml"
    clips = [beginning_of(name, 0.5, tmp_path) for name in ("side_kick", "stand")]
    manifest.write_text("clips:\n" + "".join(f"  - {{file: {clip}}}\n" for clip in clips))
    execute([
        f"motions={manifest}", *SMALL[1:], f"iterations={WARM_UP + 2}", f"evaluate_every={WARM_UP + 2}",
        f"run_dir={tmp_path / 'run'}", "world_model.processes=1",
    ])  # fmt: skip
    rows = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    assert {"clip/side_kick/survival", "clip/stand/survival"} <= rows[-1].keys()


MILE = [
    "train=last_mile", "precision=fp32", "threads=1", "num_envs=8", "evaluate_every=null",
    "learner.actor_hidden=[32,32]", "learner.critic_hidden=[16,16]", "learner.exploration.steps=4",
    "learner.horizon=4", "learner.minibatches=1", "iterations=2",
]  # fmt: skip


@pytest.mark.parametrize("source", ["", "actor.onnx"])
def test_ppo_goes_on_with_a_trackers_policy(small, trained, unjudged, tmp_path, source):
    """While only the critic learns the actor is the tracker's to the last bit."""
    observations, wanted = _sight(trained)
    execute([small[0], *MILE, f"init_from={trained / source}", f"run_dir={tmp_path / 'waits'}"])
    assert np.array_equal(_actions(tmp_path / "waits" / "actor.onnx", observations), wanted)
    lineage = json.loads((tmp_path / "waits" / "summary.json").read_text())["lineage"]
    assert lineage["networks"] == ["actor"]


def test_then_its_actor_moves(small, trained, unjudged, tmp_path):
    observations, wanted = _sight(trained)
    execute([small[0], *MILE, f"init_from={trained}", f"run_dir={tmp_path / 'moves'}", "learner.critic_first=0"])
    moved = np.abs(_actions(tmp_path / "moves" / "actor.onnx", observations) - wanted)
    assert 0.0 < moved.max() < 1.0


def _sight(trained):
    """Some observations, and what the tracker does."""
    observations = np.random.default_rng(0).normal(size=(5, _width(trained / "actor.onnx"))).astype(np.float32)
    return observations, _actions(trained / "actor.onnx", observations)


def test_the_last_mile_is_a_run_of_its_own_that_begins_with_what_was_exported(small, trained, tmp_path, monkeypatch):
    """Asked for by one word, after a run that was completed; its own training is left out here.

    It meets what was asked for, and is in all else as its preset says.
    """
    begun = []
    nearest_preset({})  # composed once for a process, as this machine has it
    monkeypatch.setattr("train.config.resolve_device", lambda wanted: "cuda" if wanted == "auto" else wanted)

    def completed(setup, stop):
        begun.append(setup)
        setup.run_dir.mkdir(parents=True, exist_ok=True)
        shutil.copy(trained / "actor.onnx", setup.run_dir)
        return outcome

    monkeypatch.setattr("train.command.train", completed)
    for outcome, last_mile, runs in (("completed", "none", 1), ("stopped", "ppo", 1), ("completed", "ppo", 2)):
        folder = tmp_path / f"{outcome}_{last_mile}"
        execute(
            [
                small[0],
                "train=clip",
                *SMALL[2:],
                f"init_from={trained}",
                f"last_mile={last_mile}",
                f"run_dir={folder}",
                "seed=5",
                "device=cpu",
                "environment.randomization.friction=[0.6,1.1]",
                "environment.events.push.params.velocity_m_s=0.6",
            ]
        )
        assert len(begun) == runs
        first, *second = begun
        assert first.config.world_model is not None and first.config.init_from == str(trained)
        for mile in second:
            assert mile.config.world_model is None and mile.config.init_from == str(folder / "actor.onnx")
            assert (mile.run_dir, mile.config.seed, mile.config.device) == (folder / "last_mile", 5, "cpu")
            assert mile.config.num_envs == 512
            met = mile.config.environment
            assert (met.randomization.friction, met.randomization.nominal_share) == ((0.6, 1.1), 0.25)
            assert (met.events["push"].params, met.events["push"].interval_s) == ({"velocity_m_s": 0.6}, (5.0, 10.0))
            assert f"motion={mile.config.motion}" == small[0]
        begun.clear()


def test_no_figure_and_no_blind_spot_keeps_an_actor_from_being_written(small, unjudged, tmp_path, monkeypatch):
    """Be it no number, or fail to be told."""

    def diverged(*arguments):
        raise NonFiniteError("rewards")

    monkeypatch.setattr("train.world_model.learner.blind_spots", diverged)
    run = tmp_path / "run"
    with pytest.raises(NonFiniteError):
        execute([*small, f"iterations={WARM_UP + 2}", f"evaluate_every={WARM_UP + 2}", f"run_dir={run}"])
    assert read_metadata(run / "actor.onnx").spec.provenance["evaluation"]["nominal_empbpe_mm"] is None
    assert json.loads((run / "summary.json").read_text())["outcome"] == "completed"


def _width(path):
    return onnxruntime.InferenceSession(str(path)).get_inputs()[0].shape[1]


def _actions(path, observations):
    session = onnxruntime.InferenceSession(str(path))
    return session.run(["action"], {session.get_inputs()[0].name: observations})[0]
