"""Small actors for the tests: a robot of three joints, a spec and a two-layer graph with known weights."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from policy.metadata import write_metadata
from policy.spec import ActorSpec, MotionInfo, ObservationGroup, ObservationTerm
from robot.robot import Robot, load_robot

JOINTS = ("hip", "knee", "ankle")
GROUP = ObservationGroup(
    "obs",
    (
        ObservationTerm("dof_pos", (0, 1)),
        ObservationTerm("base_ang_vel", (0,), 0.25),
        ObservationTerm("actions", (2, 0), 0.5),
        ObservationTerm("ref_motion_phase", (0,)),
        ObservationTerm("dof_vel", (1,), 0.05, 2.0),
        ObservationTerm("projected_gravity", (0,)),
    ),
)
SIZE = 6 + 3 + 6 + 1 + 3 + 3


def toy_robot(joint_names=JOINTS) -> Robot:
    """The joint names are all that the actor contract looks at."""
    return replace(load_robot(), name="toy", joint_names=tuple(joint_names))


def toy_motion(**changes) -> MotionInfo:
    values = dict(
        name="bow",
        fps=30.0,
        num_frames=31,
        duration_s=1.0,
        sha256="ab" * 32,
        root_height_m=0.1 + 0.2,
        start_joint_pos_rad=np.array([0.1, -0.2, 1.0 / 3.0]),
    )
    return MotionInfo(**(values | changes))


def toy_spec(**changes) -> ActorSpec:
    values = dict(
        robot="toy",
        joint_names=JOINTS,
        default_pos_rad=np.array([-0.1, 0.3, 1.0 / 7.0]),
        kp=np.array([100.0, 150.0, 40.0]),
        kd=np.array([2.0, 4.0, 0.1]),
        action_scale=np.array([0.25, 0.0745, 0.3]),
        action_clip=100.0,
        control_period_s=0.02,
        observations=(GROUP,),
        motion=toy_motion(),
        provenance={"samples": 12, "git": "abc"},
    )
    return ActorSpec(**(values | changes))


def weights(size=SIZE, joints=3, hidden=16, seed=3):
    """(W1 (h, n), b1, W2 (J, h), b2) float32."""
    rng = np.random.default_rng(seed)
    shapes = [(hidden, size), (hidden,), (joints, hidden), (joints,)]
    return [(rng.normal(size=shape) / np.sqrt(shape[-1])).astype(np.float32) for shape in shapes]


def write_graph(
    path: Path, size=SIZE, joints=3, *, params=None, name="obs", dtype=TensorProto.FLOAT, opset=17, outputs=("action",)
) -> Path:
    """action = W2 tanh(W1 obs + b1) + b2."""
    params = weights(size, joints) if params is None else params
    kind = helper.tensor_dtype_to_np_dtype(dtype)
    stored = [numpy_helper.from_array(p.astype(kind), f"p{i}") for i, p in enumerate(params)]
    nodes = [
        helper.make_node("Gemm", [name, "p0", "p1"], ["h"], transB=1),
        helper.make_node("Tanh", ["h"], ["t"]),
        *(helper.make_node("Gemm", ["t", "p2", "p3"], [output], transB=1) for output in outputs),
    ]
    graph = helper.make_graph(
        nodes,
        "toy",
        [helper.make_tensor_value_info(name, dtype, [1, size])],
        [helper.make_tensor_value_info(output, dtype, [1, joints]) for output in outputs],
        stored,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    onnx.save(model, str(path))
    return path


def write_actor(path: Path, spec: ActorSpec | None = None, motion_npz: bytes | None = b"a clip", **graph) -> Path:
    write_graph(path, **graph)
    spec = toy_spec() if spec is None else spec
    write_metadata(path, spec, motion_npz if spec.motion is not None else None)
    return path


def set_metadata(path: Path, key: str, value: str | None) -> None:
    """Overwrite (or, with None, drop) one metadata entry behind the writer's back."""
    model = onnx.load(str(path))
    entries = {entry.key: entry.value for entry in model.metadata_props}
    entries.pop(key, None)
    onnx.helper.set_model_props(model, entries if value is None else entries | {key: value})
    onnx.save(model, str(path))


def random_states(ticks: int, joints: int = 3, seed: int = 11) -> list[dict]:
    """States as ``PolicyController.act`` takes them, joints in the robot's order."""
    rng = np.random.default_rng(seed)
    states = []
    for tick in range(ticks):
        quat = rng.normal(size=4)
        states.append(
            dict(
                base_quat_wxyz=quat / np.linalg.norm(quat),
                base_ang_vel_b=rng.normal(size=3),
                joint_pos_rad=rng.normal(size=joints),
                joint_vel_rad_s=10.0 * rng.normal(size=joints),
                phase=tick / ticks,
            )
        )
    return states
