"""A training that begins with another one's weights: which, what it says of them, and what does not fit."""

import hashlib
import json

import pytest
import torch

from core.errors import InputError
from policy.actor import load_actor, resolve_actor
from policy.layouts import pbhc_actor_group
from robot.robot import load_robot
from tests.train.point_mass import PointMassEnv
from tests.train.point_mass_run import make_learner, make_runner
from tests.train.test_learner import collect
from tests.train.worlds import beginning_of
from train.checkpoint import Checkpoints
from train.config import compose_document
from train.lineage import begin_from, find_source
from train.run import main
from train.setup import new_setup


@pytest.fixture(scope="module")
def robot():
    return load_robot()


def test_a_run_gives_its_averaged_actor_and_its_critic(tmp_path, robot):
    runner = make_runner(tmp_path, 3, "learner.average_iterations=3")
    runner.run()
    source = find_source(str(tmp_path), robot, pbhc_actor_group())
    other, said = make_learner(PointMassEnv(), "seed=9"), []
    lineage = begin_from(source, other, said.append)
    observations = PointMassEnv().reset()
    expected = runner.learner.actor_with(runner.learner.weights)(observations["actor"])
    assert torch.equal(other.actor(observations["actor"]), expected)
    assert torch.equal(other.critic(observations["critic"]), runner.learner.critic(observations["critic"]))
    assert all(torch.equal(other.weights[name], value) for name, value in other.actor.state_dict().items())
    path = Checkpoints(tmp_path).paths()[-1]
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert lineage == {"file": path.name, "sha256": digest, "iteration": 3, "networks": ["actor", "critic"]}
    assert "actor and critic" in said[0]


def test_a_critic_of_another_shape_begins_anew(tmp_path, robot):
    make_runner(tmp_path, 1).run()
    source = find_source(str(tmp_path), robot, pbhc_actor_group())
    other = make_learner(PointMassEnv(), "learner.critic_hidden=[16]")
    before = [value.clone() for value in other.critic.state_dict().values()]
    assert begin_from(source, other, lambda line: None)["networks"] == ["actor"]
    assert all(map(torch.equal, before, other.critic.state_dict().values()))


def test_an_actor_of_another_shape_is_refused_and_nothing_changes(tmp_path, robot):
    make_runner(tmp_path, 1).run()
    source = find_source(str(tmp_path), robot, pbhc_actor_group())
    other = make_learner(PointMassEnv(), "learner.actor_hidden=[32,16]")
    before = [value.clone() for value in other.actor.parameters()]
    with pytest.raises(InputError, match=r"the actor's weights do not fit.*mlp.hidden.2.weight of \[32, 32\] for \[16"):
        begin_from(source, other, lambda line: None)
    assert all(map(torch.equal, before, other.actor.parameters()))


def test_a_bundled_actor_gives_the_weights_of_its_graph(robot):
    seen = load_actor(resolve_actor("side_kick"), robot).spec.observations[0]
    source = find_source("side_kick", robot, seen)
    digest = hashlib.sha256(resolve_actor("side_kick").read_bytes()).hexdigest()
    summary = json.loads(resolve_actor("side_kick").with_name("summary.json").read_text())
    assert source.lineage["sha256"] == digest == summary["actor_sha256"]
    assert source.lineage["iteration"] == summary["exported_iteration"] > 0
    assert source.networks["actor"]["mlp.network.output.bias"].shape == (23,)


@pytest.mark.parametrize(
    ("name", "message"),
    [("nosuchactor", "no such actor"), ("side_kick", "sees something else.*projected_gravity"), (".", "no checkpoint")],
)
def test_what_is_no_source_is_refused(tmp_path, monkeypatch, robot, name, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        find_source(name, robot, pbhc_actor_group())


def test_only_the_critic_learns_at_first():
    env = PointMassEnv()
    learner = make_learner(env, "learner.critic_first=2", "learner.kl_schedule=minibatch")
    actor, critic = ([value.clone() for value in net.parameters()] for net in (learner.actor, learner.critic))
    for _ in range(2):
        learner.update(collect(learner, env))
        assert all(map(torch.equal, actor, learner.actor.parameters()))
        assert learner.rates.value == learner.settings.learning_rate
    assert not any(map(torch.equal, critic, learner.critic.parameters()))
    learner.update(collect(learner, env))
    assert not any(map(torch.equal, actor, learner.actor.parameters()))


def test_a_whole_training_goes_on_from_an_exported_actor(tmp_path, light):
    """Held still, the actor that comes out is the one that went in, and says so."""
    short = [
        f"motion={beginning_of('stand', 0.6, tmp_path)}", "train=window", "num_envs=4", "learner.horizon=4",
        "learner.exploration.steps=2", "threads=1",
    ]  # fmt: skip
    first, second = tmp_path / "first", tmp_path / "second"
    assert main([*short, "iterations=1", "seed=1", f"run_dir={first}"]) == 0
    more = ["iterations=2", "seed=2", "learner.critic_first=2", f"init_from={first / 'actor.onnx'}"]
    assert main([*short, *more, f"run_dir={second}"]) == 0
    actors = [load_actor(run / "actor.onnx", load_robot()) for run in (first, second)]
    size = actors[0].session.get_inputs()[0].shape[1]
    seen = {"actor_obs": torch.linspace(-1.0, 1.0, size).numpy()}
    assert actors[0].infer(seen).action.tolist() == actors[1].infer(seen).action.tolist()
    lineage = actors[1].spec.provenance["lineage"]
    assert lineage["sha256"] == actors[0].sha256 and lineage["iteration"] == 1
    assert json.loads((second / "summary.json").read_text())["lineage"] == lineage


def test_a_trackers_model_serves_whatever_else_the_actor_sees(tmp_path):
    words = ["motion=side_kick", "train=goals", "init_from=tracker", f"run_dir={tmp_path / 'run'}"]
    source = new_setup(compose_document([*words, "init_networks=[model]"])).source
    assert source is not None and set(source.networks) == {"model"}
    for networks in ("null", "[actor,model]", "[critic]"):
        with pytest.raises(InputError, match="sees something else"):
            new_setup(compose_document([*words, f"init_networks={networks}"]))
