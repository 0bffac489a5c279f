"""Trackers exported by mjlab and BeyondMimic: a file as their exporters write it, seen by the real controller.

What they observe is computed here another way: by MuJoCo's own bodies and its rotation matrices.
"""

import json
from pathlib import Path

import mujoco
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from core.errors import InputError
from deploy.actors import load_run
from deploy.cli import main as deploy
from deploy.settings import load_settings
from motion.importers.g1_joints import JOINTS_29
from motion.library import open_motion
from motion.reference import build_reference
from policy.actor import load_actor
from policy.controller import PolicyController
from policy.spec import ObservationTerm
from robot.robot import load_robot
from sim2sim.cli import main as evaluate
from tests.motion.robot_files import ISAAC_29, mjlab_arrays, npz_bytes
from tests.policy.toys import set_metadata, weights

ROBOT, WITH_WRISTS = load_robot(), load_robot("g1_29dof")
ORDER = np.random.default_rng(7).permutation(ROBOT.num_joints)  # theirs goes through the tree level by level
NAMES = [ROBOT.joint_names[i] for i in ORDER]
TAICHI = build_reference(open_motion("taichi", ROBOT), ROBOT).joint_pos_rad
OBSERVED = ("command", "motion_anchor_ori_b", "base_ang_vel", "joint_pos", "joint_vel", "actions")
SIZE = 46 + 6 + 3 + 3 * 23


def by_comma(values) -> str:
    return ",".join(value if isinstance(value, str) else f"{value:.3f}" for value in values)


def metadata(robot=ROBOT, order=ORDER, **changes) -> dict[str, str]:
    values = {
        "run_path": "group/project/run",
        "joint_names": by_comma(robot.joint_names[i] for i in order),
        "joint_stiffness": by_comma(robot.kp[order]),
        "joint_damping": by_comma(robot.kd[order]),
        "default_joint_pos": by_comma(robot.default_pos_rad[order]),
        "command_names": "motion",
        "observation_names": by_comma(OBSERVED),
        "action_scale": by_comma(np.linspace(0.1, 0.5, len(order))),
        "anchor_body_name": "torso_link",
        "body_names": "pelvis,torso_link",
    }
    return {key: value for key, value in (values | changes).items() if value is not None}


def write_tracker(path: Path, size: int = SIZE, told=TAICHI[:, ORDER], leak: float = 0.0, **changes) -> Path:
    """A graph with their inputs and outputs: a network, and the motion it was trained on, picked by time_step.

    leak: how much of time_step reaches the action, which it should not.
    """
    joints = told.shape[1]
    params = weights(size, joints)
    arrays = {"frames": told.astype(np.float32), "last": np.array(len(told) - 1), "leak": np.float32([leak])}
    arrays |= {f"p{i}": param for i, param in enumerate(params)}
    stored = [numpy_helper.from_array(array, name) for name, array in arrays.items()]
    nodes = [
        helper.make_node("Gemm", ["obs", "p0", "p1"], ["h"], transB=1),
        helper.make_node("Tanh", ["h"], ["t"]),
        helper.make_node("Gemm", ["t", "p2", "p3"], ["network"], transB=1),
        helper.make_node("Mul", ["time_step", "leak"], ["leaked"]),
        helper.make_node("Add", ["network", "leaked"], ["actions"]),
        helper.make_node("Cast", ["time_step"], ["whole"], to=TensorProto.INT64),
        helper.make_node("Min", ["whole", "last"], ["row"]),
        helper.make_node("Squeeze", ["row"], ["flat"]),
        helper.make_node("Gather", ["frames", "flat"], ["joint_pos"]),
    ]
    floats = {"obs": [1, size], "time_step": [1, 1], "actions": [1, joints], "joint_pos": [joints]}
    values = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in floats.items()}
    graph = helper.make_graph(
        nodes, "tracker", [values["obs"], values["time_step"]], [values["joint_pos"], values["actions"]], stored
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.helper.set_model_props(model, metadata(**changes))
    onnx.save(model, str(path))
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_run(path, "taichi", ROBOT, load_settings().entry)
    return str(caught.value)


def torso(robot, quat_wxyz: np.ndarray, joint_pos_rad: np.ndarray) -> np.ndarray:
    """Its rotation matrix (3, 3) in the world, by MuJoCo."""
    data = mujoco.MjData(robot.model)
    data.qpos[:] = [0.0, 0.0, 0.8, *quat_wxyz, *joint_pos_rad]
    mujoco.mj_kinematics(robot.model, data)
    return data.body("torso_link").xmat.reshape(3, 3).copy()


def test_the_metadata_becomes_a_spec(tmp_path):
    spec = load_run(write_tracker(tmp_path / "a.onnx"), "taichi", ROBOT, load_settings().entry).actor.spec
    assert spec.joint_names == tuple(NAMES)
    np.testing.assert_allclose(spec.kp, ROBOT.kp[ORDER])
    np.testing.assert_allclose(spec.kd, ROBOT.kd[ORDER])
    np.testing.assert_allclose(spec.default_pos_rad, ROBOT.default_pos_rad[ORDER])
    np.testing.assert_allclose(spec.action_scale, np.round(np.linspace(0.1, 0.5, 23), 3))
    assert (spec.control_period_s, spec.history_start, spec.follows) == (0.02, "repeat", "any_clip")
    assert spec.motion.name == "taichi" and spec.provenance["run"] == "group/project/run"


@pytest.mark.parametrize("tick", [0, 40])
def test_it_sees_what_it_saw_in_training(tmp_path, tick):
    run = load_run(write_tracker(tmp_path / "a.onnx"), "taichi", ROBOT, load_settings().entry)
    assert_seen(run, ROBOT, ORDER, tick)


@pytest.mark.parametrize("order", [JOINTS_29, ISAAC_29], ids=["mjlab", "Isaac Lab"])
def test_with_wrists_too(tmp_path, order):
    """An actor and its motion as those programs leave them."""
    policy, motion, index = write_task(tmp_path, order)
    assert_seen(load_run(policy, motion, WITH_WRISTS, load_settings().entry), WITH_WRISTS, index, 3)


def write_task(folder: Path, order) -> tuple[Path, Path, np.ndarray]:
    """Actor and motion of a task with 29 joints in this order, and the order as columns of the robot's."""
    arrays = mjlab_arrays(WITH_WRISTS, order, num_frames=6)
    (folder / "motion.npz").write_bytes(npz_bytes(arrays))
    index = np.array([WITH_WRISTS.joint_names.index(name) for name in order])
    told = arrays["joint_pos"]
    path = write_tracker(folder / "policy.onnx", 58 + 6 + 3 + 87, told, robot=WITH_WRISTS, order=index)
    return path, folder / "motion.npz", index


def assert_seen(run, robot, order, tick):
    """The observation at a tick of the clip, the first of the actor, put together by hand."""
    rng, reference, count = np.random.default_rng(3), run.reference, robot.num_joints
    quat = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])
    gyro, speeds = rng.normal(size=3), rng.normal(size=count)
    joints = robot.default_pos_rad + rng.normal(size=count) / 5
    controller = PolicyController(run.actor, robot)
    seen = controller.act(quat, gyro, joints, speeds, 0.0, reference=reference, tick=tick).observation["obs"]
    # The clip's heading becomes the robot's where the actor takes over.
    asked = reference.root_quat_wxyz[tick]
    own, theirs = torso(robot, quat, joints), torso(robot, asked, reference.joint_pos_rad[tick])
    turn = heading(quat) - heading(asked)
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    relative = own.T @ about_z @ theirs
    expected = np.concatenate([
        reference.joint_pos_rad[tick][order],
        reference.joint_vel_rad_s[tick][order],
        relative[:, :2].ravel(),
        gyro,
        joints[order] - run.actor.spec.default_pos_rad,
        speeds[order],
        np.zeros(count),
    ])  # fmt: skip
    np.testing.assert_allclose(seen, expected, atol=2e-6)


def heading(quat_wxyz: np.ndarray) -> float:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat_wxyz)
    return float(np.arctan2(matrix[3], matrix[0]))


def test_its_action_is_that_of_the_network_and_reaches_the_joints_by_name(tmp_path):
    run = load_run(write_tracker(tmp_path / "a.onnx"), "taichi", ROBOT, load_settings().entry)
    controller = PolicyController(run.actor, ROBOT)
    still = [1.0, 0.0, 0.0, 0.0], np.zeros(3), ROBOT.default_pos_rad, np.zeros(23)
    first = controller.act(*still, 0.0, reference=run.reference, tick=0)
    w1, b1, w2, b2 = weights(SIZE, 23)
    action = w2 @ np.tanh(w1 @ first.observation["obs"] + b1) + b2
    np.testing.assert_allclose(first.action[ORDER], action, atol=1e-5)
    scale = np.round(np.linspace(0.1, 0.5, 23), 3)
    np.testing.assert_allclose(first.target_rad[ORDER], ROBOT.default_pos_rad[ORDER] + scale * action, atol=1e-5)
    second = controller.act(*still, 0.0, reference=run.reference, tick=1)
    np.testing.assert_allclose(second.observation["obs"][-23:], action, atol=1e-5)


def test_a_history_is_oldest_first_and_begins_with_its_first_sample(tmp_path):
    observed, lengths = "base_ang_vel,motion_command,last_action", by_comma([3.0, 2.0, 0.0])
    changes = {"observation_names": observed, "observation_history_lengths": lengths, "action_scale": "0.25"}
    run = load_run(write_tracker(tmp_path / "a.onnx", 9 + 92 + 23, **changes), "taichi", ROBOT, load_settings().entry)
    (group,) = run.actor.spec.observations
    assert group.terms[3:7] == (
        ObservationTerm("reference_joint_angle", (1,), ticks=(0,)),
        ObservationTerm("reference_joint_vel", (1,), ticks=(0,)),
        ObservationTerm("reference_joint_angle", (0,), ticks=(0,)),
        ObservationTerm("reference_joint_vel", (0,), ticks=(0,)),
    )
    np.testing.assert_allclose(run.actor.spec.action_scale, 0.25)
    controller, reference = PolicyController(run.actor, ROBOT), run.reference
    for tick, rates in enumerate(([1.0, 1.0, 1.0], [1.0, 1.0, 2.0], [1.0, 2.0, 3.0], [2.0, 3.0, 4.0])):
        state = [1.0, 0.0, 0.0, 0.0], np.full(3, tick + 1.0), ROBOT.default_pos_rad, np.zeros(23)
        seen = controller.act(*state, 0.0, reference=reference, tick=tick).observation["obs"]
        np.testing.assert_allclose(seen[:9], np.repeat(rates, 3))
        np.testing.assert_allclose(seen[9:32], reference.joint_pos_rad[max(0, tick - 1)][ORDER], atol=1e-6)
        np.testing.assert_allclose(seen[55:78], reference.joint_pos_rad[tick][ORDER], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"default_joint_pos": None}, "default_joint_pos: missing metadata, got action_scale, "),
        ({"joint_damping": "1.0,much"}, "joint_damping: not all numbers, got 1.0,much, expected 23 numbers"),
        ({"joint_stiffness": "1.0,2.0"}, "kp: wrong length, got shape (2,), expected 23 numbers"),
        ({"anchor_body_name": None}, "anchor_body_name: missing metadata, got action_scale, "),
        ({"anchor_body_name": "chest"}, "looks at a body that robot 'g1_23dof' lacks, got chest, expected pelvis, "),
        ({"observation_history_lengths": "1,1"}, "observation_history_lengths: not usable, got 1,1, expected 6 whole"),
        ({"observation_history_lengths": "1,1,1,1,1,-1"}, "observation_history_lengths: not usable, got 1,1,1,1,1,-1"),
        (
            {"observation_history_lengths": "1,1,1,1,1,1.5"},
            "observation_history_lengths: not usable, got 1,1,1,1,1,1.5",
        ),
        ({"observation_history_lengths": "1.000"}, "_lengths: not usable, got 1.000, expected 6 whole"),
        ({"action_term": "joint_effort"}, "action_term: not supported, got joint_effort, expected joint_pos"),
        ({"command_names": "twist"}, "command_names: not supported, got twist, expected motion"),
        ({"action_names": by_comma(sorted(NAMES))}, "action_names: not supported, got left_ankle_pitch_joint,"),
        ({"action_offset": "0.5"}, "action_offset: not supported, got 0.5, expected the default pose"),
        ({"told": TAICHI[::2, ORDER]}, "is not the one this actor was trained on, or is played at another rate, got "),
        ({"told": TAICHI[:-40, ORDER] + 0.2}, "the motion given is not the one this actor was trained on"),
        ({"leak": 1e-3}, "the action depends on what is never told, got time_step"),
        (
            {"observation_names": "command,motion_anchor_pos_b,base_lin_vel,actions"},
            "observation_names: a robot does not measure its place and velocity in the world, "
            "got motion_anchor_pos_b, base_lin_vel; train the task without state estimation",
        ),
        ({"observation_names": "command,heights"}, "observation_names: unknown observation, got heights, expected of "),
        ({"observation_names": "command,actions"}, "graph input 'obs': wrong size, got [1, 124], expected [1, 69]"),
    ],
)
def test_what_cannot_be_played_is_refused_by_name(tmp_path, changes, text):
    path = write_tracker(tmp_path / "a.onnx", **changes)
    said = refusal(path)
    assert text in said and said.startswith(f"{path}: ")


def test_one_of_another_robot_is_refused(tmp_path):
    names = by_comma([*NAMES[:-1], "left_wrist_roll_joint"])
    said = refusal(write_tracker(tmp_path / "a.onnx", joint_names=names))
    assert f"the robot lacks left_wrist_roll_joint; the actor lacks {NAMES[-1]}" in said


def test_a_clip_is_asked_for(tmp_path):
    path = write_tracker(tmp_path / "a.onnx")
    with pytest.raises(InputError, match="carries no reference motion: give --motion"):
        load_actor(path, ROBOT)
    set_metadata(path, "joint_names", None)
    assert "not a known kind of actor" in refusal(path)


def test_it_runs_through_the_loop(tmp_path, capsys):
    path = write_tracker(tmp_path / "a.onnx", action_scale="0.001")
    given = ["--policy", str(path), "--motion", "taichi", "--start", "reference", "--duration", "1"]
    assert deploy(["--backend", "mock", *given]) == 0
    assert "TRACKING" in capsys.readouterr().out


def test_what_newer_exporters_say_besides_is_understood(tmp_path):
    offset = by_comma(ROBOT.default_pos_rad[ORDER])
    path = write_tracker(
        tmp_path / "a.onnx", action_term="joint_pos", action_names=by_comma(NAMES), action_offset=offset
    )
    assert load_run(path, "taichi", ROBOT, load_settings().entry).actor.spec.follows == "any_clip"


def test_it_is_scored_on_the_robot_with_wrists(tmp_path):
    policy, motion, _ = write_task(tmp_path, JOINTS_29)
    given = ["--robot", "g1_29dof", "--policy", str(policy), "--motion", str(motion)]
    assert evaluate([*given, "--json", str(tmp_path / "scores.json")]) == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["motion"] == "motion" and np.isfinite(scores["metrics"]["empjpe_mrad"]["mean"])
    said = refusal(policy)
    assert "the robot lacks left_wrist_roll_joint, left_wrist_pitch_joint, " in said
    assert "give actors of this robot; in simulation --start reference needs no stand actor" in said
