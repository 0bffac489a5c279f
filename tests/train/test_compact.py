"""Exported weights in half precision: the same results, in half the bytes."""

import io

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import nn

from train.compact import LEAST, round_to_half, with_half_weights

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the tracing exporter, as in train/export


def exported(network: nn.Module) -> bytes:
    buffer = io.BytesIO()
    torch.onnx.export(network, (torch.zeros(1, 40),), buffer, dynamo=False, opset_version=17, input_names=["x"])
    return buffer.getvalue()


def answer(graph: bytes, x: np.ndarray) -> np.ndarray:
    session = onnxruntime.InferenceSession(graph, providers=["CPUExecutionProvider"])
    return session.run(None, {"x": x})[0]


def test_a_rounded_network_is_stored_in_half_the_bytes_and_answers_the_same():
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(40, 200), nn.SiLU(), nn.Linear(200, 300), nn.SiLU(), nn.Linear(300, 2))
    before = {name: value.clone() for name, value in network.state_dict().items()}
    round_to_half(network)
    for name, value in network.state_dict().items():
        if value.numel() < LEAST:
            assert torch.equal(value, before[name])
        else:
            assert (value - before[name]).abs().max() <= 2.0**-11 * before[name].abs().max() + 2.0**-24
            assert not torch.equal(value, before[name])
    whole = exported(network)
    small = with_half_weights(whole)
    assert len(small) < 0.55 * len(whole)
    x = np.random.default_rng(1).normal(size=(1, 40)).astype(np.float32)
    assert np.array_equal(answer(whole, x), answer(small, x))
    assert {w.name for w in onnx.load_from_string(small).graph.initializer} == {
        w.name for w in onnx.load_from_string(whole).graph.initializer
    }


def test_weights_that_half_precision_does_not_hold_stay_as_they_are():
    torch.manual_seed(0)
    whole = exported(nn.Linear(40, 200))
    small = onnx.load_from_string(with_half_weights(whole))
    assert all(weight.data_type == onnx.TensorProto.FLOAT for weight in small.graph.initializer)
    assert not [node for node in small.graph.node if node.op_type == "Cast"]
