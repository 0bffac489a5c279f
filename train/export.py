"""Actor → one self-describing ONNX file, proven before it appears.

The graph is the mean action, prior included, worked out in fp32.
"""

import hashlib
import io
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnxruntime
import torch

from core.files import replacing
from motion.clip import Clip, clip_to_bytes
from motion.reference import joint_columns
from policy.metadata import write_metadata
from policy.spec import ActorSpec, ObservationGroup, motion_info
from robot.robot import Robot
from train.compact import round_to_half, with_half_weights
from train.learner.networks import ActorNetwork
from train.mdp.tracking import ACTION_CLIP, ACTION_SCALE, CONTROL_PERIOD_S

TOLERANCE = 1e-5
_OPSET = 17
_PROBE_SEED = 0


class ExportError(RuntimeError):
    """The exported graph does not compute what the actor computes."""


def actor_spec(
    robot: Robot,
    clip: Clip,
    motion_name: str,
    provenance: Mapping[str, Any],
    group: ObservationGroup,
    *,
    any_clip: bool = False,
) -> ActorSpec:
    """What the file says about the actor; joints in the robot's order. any_clip: it is given one at run time."""
    start = clip.joint_pos_rad[0, joint_columns(clip, robot)]
    return ActorSpec(
        robot=robot.name,
        joint_names=robot.joint_names,
        default_pos_rad=robot.default_pos_rad,
        kp=robot.kp,
        kd=robot.kd,
        action_scale=np.full(robot.num_joints, ACTION_SCALE),
        action_clip=ACTION_CLIP,
        control_period_s=CONTROL_PERIOD_S,
        observations=(group,),
        history_start="zeros",
        motion=None if any_clip else motion_info(clip, motion_name, start),
        follows="any_clip" if any_clip else "clip",
        provenance=dict(provenance),
    )


def export_actor(actor: ActorNetwork, spec: ActorSpec, clip: Clip, path: Path) -> str:
    """Write the actor to ``path``, which appears only when it is proven and complete; return the file's SHA-256.

    Weights that training sets no finer than half precision holds are stored in it.

    Raises:
        ExportError: torch and onnxruntime differ by more than 1e-5 (relative to the largest action above 1).
    """
    twin = actor.deployed().cpu()
    group = spec.observations[0].name
    if actor.mlp.half_suffices:
        round_to_half(twin.mlp)
    graph = with_half_weights(to_onnx(twin, group))
    verify(twin, graph, group)
    with replacing(path) as unfinished:
        unfinished.write_bytes(graph)
        write_metadata(unfinished, spec, None if spec.motion is None else clip_to_bytes(clip))
        content = unfinished.read_bytes()
        verify(twin, content, group)
    return hashlib.sha256(content).hexdigest()


def to_onnx(actor: ActorNetwork, input_name: str) -> bytes:
    """The graph as bytes: input (n, Da) of that name, output ``action`` (n, J)."""
    buffer = io.BytesIO()
    example = torch.zeros(1, actor.observation_size)
    with warnings.catch_warnings():
        # The tracing exporter is deprecated in favour of one that needs onnxscript; torch is pinned.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            actor, (example,), cast(Any, buffer), dynamo=False, opset_version=_OPSET, input_names=[input_name],
            output_names=["action"], dynamic_axes={input_name: {0: "batch"}, "action": {0: "batch"}},
        )  # fmt: skip
    return buffer.getvalue()


def verify(actor: ActorNetwork, graph: bytes, input_name: str) -> float:
    """Compare the graph with the actor on random and extreme inputs; return the largest difference.

    Raises:
        ExportError: it exceeds 1e-5 (relative to the sample's largest action, where that is above 1).
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    differences = []
    for obs in _probes(actor.observation_size):
        with torch.no_grad():
            wanted = actor(obs).numpy()
        got = np.concatenate([session.run(None, {input_name: row[None].numpy()})[0] for row in obs])
        scale = np.maximum(1.0, np.abs(wanted).max(axis=1, keepdims=True))
        differences.append(np.abs(got - wanted) / scale)
    worst = float(np.concatenate(differences).max())  # NaN if any is
    if not worst <= TOLERANCE:
        raise ExportError(f"exported graph differs from the actor by {worst:.3g}, allowed {TOLERANCE:g}")
    return worst


def _probes(size: int) -> list[torch.Tensor]:
    """Inputs (n, size): usual, wide, at the clip, one-hot, zero."""
    generator = torch.Generator().manual_seed(_PROBE_SEED)
    usual = torch.randn(32, size, generator=generator)
    extreme = torch.sign(torch.randn(8, size, generator=generator)) * 100.0
    hot = torch.eye(size)[torch.randperm(size, generator=generator)[:16]] * 100.0
    return [usual, 10.0 * usual, extreme, hot, torch.zeros(1, size)]
