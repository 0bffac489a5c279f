"""The exported file computes what the actor computes, and only then exists."""

import copy
from functools import partial

import numpy as np
import onnxruntime
import pytest
import torch

from motion.library import open_motion
from policy.actor import load_actor
from policy.layouts import pbhc_actor_group, tracker_actor_group
from robot.robot import load_robot
from train import export
from train.distil.vae import PriorDecoder
from train.learner.networks import ActorNetwork, Mlp
from train.world_model.network import Network
from train.world_model.policy import BoundedResidual, Layout


class TableBase(torch.nn.Module):
    """A table over one input, interpolated, and a clipped feedback: what a model-based base consists of."""

    def __init__(self, size, actions, generator):
        super().__init__()
        self.register_buffer("table", torch.randn(9, actions, generator=generator))
        self.register_buffer("gain", torch.randn(size, actions, generator=generator))

    def forward(self, obs):
        at = obs[:, -1].clamp(0.0, 1.0) * 8
        low = torch.floor(at).clamp(max=7)
        weight = (at - low)[:, None]
        index = low.long()
        reference = self.table[index] * (1 - weight) + self.table[index + 1] * weight
        return reference + (obs.double() @ self.gain.double()).float().clamp(-0.5, 0.5)


def make_actor(precision="fp32", base=True):
    generator = torch.Generator().manual_seed(1)
    mlp = Mlp(380, (64, 32), 23, activation="silu", generator=generator, precision=precision)
    return ActorNetwork(mlp, 23, (0.5, 0.1, 1.0), TableBase(380, 23, generator) if base else None)


@pytest.fixture(scope="module")
def robot():
    return load_robot("g1_23dof")


@pytest.fixture(scope="module")
def clip(robot):
    return open_motion("stand", robot)


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("base", [True, False])
def test_graph_equals_the_fp32_actor(precision, base):
    actor = make_actor(precision, base)
    graph = export.to_onnx(actor.deployed(), "actor_obs")
    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    assert [entry.name for entry in session.get_inputs()] == ["actor_obs"]
    assert [entry.name for entry in session.get_outputs()] == ["action"]
    obs = torch.randn(20, 380, generator=torch.Generator().manual_seed(9))
    expected = make_actor("fp32", base)(obs).detach().numpy()
    np.testing.assert_allclose(session.run(None, {"actor_obs": obs.numpy()})[0], expected, atol=1e-5)


def residual(kind, precision, robot):
    generator = torch.Generator().manual_seed(1)
    mlp = partial(Mlp, activation="silu", generator=generator, precision=precision)
    if kind == "latent":
        return PriorDecoder(mlp(380, (64,), 16), mlp(388, (64,), 23))
    if kind == "bounded":
        return BoundedResidual(robot, Layout(tracker_actor_group(), 23), (64,), 0.25, generator, precision)
    return mlp(380, (64,), 23)


@pytest.mark.parametrize("kind", ["plain", "bounded", "latent"])
def test_nothing_that_is_deployed_is_in_bf16(kind, robot):
    coarse, fine = (
        ActorNetwork(residual(kind, precision, robot), 23, (0.5, 0.1, 1.0)) for precision in ("bf16", "fp32")
    )
    seen = torch.randn(4, coarse.observation_size, generator=torch.Generator().manual_seed(3))
    assert torch.equal(coarse.deployed()(seen), fine(seen)) and not torch.equal(coarse(seen), fine(seen))


def test_file_is_a_complete_actor(tmp_path, robot, clip):
    actor, path = make_actor("bf16"), tmp_path / "actor.onnx"
    spec = export.actor_spec(robot, clip, "stand", {"samples": 12, "seed": 3}, pbhc_actor_group())
    digest = export.export_actor(actor, spec, clip, path)
    loaded = load_actor(path, robot)
    assert loaded.sha256 == digest
    assert loaded.spec.motion.name == "stand" and loaded.spec.motion.sha256 == clip.sha256
    assert loaded.spec.provenance == {"samples": 12, "seed": 3}
    assert loaded.spec.joint_names == robot.joint_names
    np.testing.assert_array_equal(loaded.spec.action_scale, 0.25)
    obs = torch.randn(1, 380, generator=torch.Generator().manual_seed(2))
    expected = make_actor("fp32")(obs).detach().numpy()[0]
    np.testing.assert_allclose(loaded.infer({"actor_obs": obs.numpy()[0]}).action, expected, atol=1e-5)
    assert [entry.name for entry in tmp_path.iterdir()] == ["actor.onnx"]


def test_a_graph_that_differs_never_appears(tmp_path, robot, clip, monkeypatch):
    path = tmp_path / "actor.onnx"
    path.write_bytes(b"earlier actor")
    other = make_actor()
    with torch.no_grad():
        other.mlp.output.bias[3] += 1e-3
    wrong = export.to_onnx(other.deployed(), "actor_obs")
    monkeypatch.setattr(export, "to_onnx", lambda actor, name: wrong)
    with pytest.raises(export.ExportError, match=r"differs from the actor by"):
        export.export_actor(make_actor(), export.actor_spec(robot, clip, "stand", {}, pbhc_actor_group()), clip, path)
    assert path.read_bytes() == b"earlier actor"
    assert [entry.name for entry in tmp_path.iterdir()] == ["actor.onnx"]


def test_a_graph_that_gives_nan_never_appears():
    actor = make_actor()
    with torch.no_grad():
        actor.mlp.output.bias[0] = float("nan")
    actor = actor.deployed()
    with pytest.raises(export.ExportError):
        export.verify(actor, export.to_onnx(actor, "actor_obs"), "actor_obs")


def test_a_network_in_the_middle_of_an_update_in_bf16_can_be_copied():
    network = Network(3, 2, [8], 1, generator=torch.Generator().manual_seed(1), precision="bf16")
    network.prepare()
    copied = copy.deepcopy(network)
    copied.prepare()
    x, extras = torch.randn(4, 3), torch.randn(4, 2)
    assert torch.equal(copied(x, copied.encode(extras)), network(x, network.encode(extras)))
