"""Actors of any clip, with commands, maps, held joints and a state of their own, through the real controller."""

from dataclasses import dataclass, replace

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from core.errors import InputError
from policy.actor import load_actor
from policy.controller import Given, PolicyController
from policy.inputs import CommandSpec, HeldJoint, MapSpec
from policy.metadata import write_metadata
from policy.spec import ObservationGroup, ObservationTerm
from tests.policy.toys import toy_motion, toy_robot, toy_spec

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
HALF = np.sqrt(0.5)
SPEED = CommandSpec("speed", ("x", "y", "turn"), ((-1.0, 1.0),) * 3, (0.1, 0.2, 0.3), 0.5)
GROUND = MapSpec("ground", (-0.1, 0.0, 0.1), (0.0,), 0.5, 0.1)


@dataclass(frozen=True)
class Rows:
    """Four ticks: the first joint's angle is ten times the tick's number, the root walks along its heading."""

    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    root_lin_vel_w: np.ndarray
    root_ang_vel_w: np.ndarray
    feedforward_rad: np.ndarray
    floor_m: float = 0.0


def rows() -> Rows:
    joints = np.array([[0.0, 1.0, 2.0], [10.0, 1.0, 2.0], [20.0, 1.0, 2.0], [30.0, 1.0, 2.0]])
    return Rows(
        joint_pos_rad=joints,
        joint_vel_rad_s=np.ones((4, 3)),
        root_pos_w=np.tile([0.0, 0.0, 0.8], (4, 1)),
        root_quat_wxyz=np.tile([HALF, 0.0, 0.0, HALF], (4, 1)),  # looks along +y
        root_lin_vel_w=np.tile([0.0, 0.5, 0.0], (4, 1)),
        root_ang_vel_w=np.zeros((4, 3)),
        feedforward_rad=np.tile([0.1, 0.2, 0.3], (4, 1)),
    )


def adding_actor(path, spec, size, states=("count",), sizes=(3, 3)):
    """action = the first three numbers observed + state; next state = state + 1."""
    pick = np.eye(size, 3, dtype=np.float32)
    nodes = [helper.make_node("MatMul", ["obs", "pick"], ["seen"])]
    inputs = [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, size])]
    outputs = [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 3])]
    for name in states:
        inputs.append(helper.make_tensor_value_info(f"state.{name}", TensorProto.FLOAT, [1, sizes[0]]))
        outputs.insert(0, helper.make_tensor_value_info(f"next_state.{name}", TensorProto.FLOAT, [1, sizes[1]]))
        nodes.append(helper.make_node("Add", [f"state.{name}", "one"], [f"next_state.{name}"]))
    nodes.append(
        helper.make_node("Add" if states else "Identity", ["seen", *(f"state.{n}" for n in states)], ["action"])
    )
    stored = [numpy_helper.from_array(pick, "pick"), numpy_helper.from_array(np.ones(1, np.float32), "one")]
    graph = helper.make_graph(nodes, "adding", inputs, outputs, stored)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), str(path))
    write_metadata(path, spec, None)
    return path


def test_what_looks_at_a_goal_needs_to_know_what_is_hidden(tmp_path):
    """Found at load: in the first tick of tracking it would damp a robot that stands."""
    for entry in (
        ObservationTerm("goal_point", ticks=(1,), of="head"),
        ObservationTerm("goal_steer", ticks=(0,)),
        ObservationTerm("reference_root_height", ticks=(0,), part="posture"),
    ):
        size = {"goal_point": 3, "goal_steer": 5}.get(entry.term, 1)
        path = adding_actor(tmp_path / "actor.onnx", spec_of(entry), size)
        with pytest.raises(InputError, match=rf"hidden, got {entry.term}, expected goal_visible besides"):
            load_actor(path, toy_robot(), toy_motion())


def spec_of(*terms, **changes):
    default = {"motion": None, "follows": "any_clip", "observations": (ObservationGroup("obs", terms),)}
    return toy_spec(default_pos_rad=np.zeros(3), action_scale=np.ones(3), **(default | changes))


def act(controller, quat=UPRIGHT, **more):
    return controller.act(quat, np.zeros(3), np.zeros(3), np.zeros(3), 0.0, **more)


def test_an_actor_of_any_clip_is_given_one_and_looks_ahead_on_it(tmp_path):
    spec = spec_of(ObservationTerm("reference_joint_pos", ticks=(2,)))
    path = adding_actor(tmp_path / "a.onnx", spec, 3, states=())
    robot = toy_robot()
    with pytest.raises(InputError, match="give --motion"):
        load_actor(path, robot)
    actor = load_actor(path, robot, toy_motion())
    assert actor.spec.motion is not None and actor.spec.motion.name == "bow"
    controller = PolicyController(actor, robot)
    first_joint = [act(controller, reference=rows(), tick=tick).action[0] for tick in range(4)]
    assert first_joint == [20.0, 30.0, 30.0, 30.0]  # beyond the end its last pose


def test_beyond_the_clip_the_reference_rests(tmp_path):
    spec = spec_of(ObservationTerm("reference_joint_vel", ticks=(1,)))
    robot = toy_robot()
    controller = PolicyController(
        load_actor(adding_actor(tmp_path / "a.onnx", spec, 3, states=()), robot, toy_motion()), robot
    )
    speeds = [act(controller, reference=rows(), tick=tick).action[0] for tick in range(4)]
    assert speeds == [1.0, 1.0, 1.0, 0.0]


def test_the_clips_heading_becomes_the_robots_when_the_actor_takes_over(tmp_path):
    spec = spec_of(ObservationTerm("reference_orientation", ticks=(1,)))
    robot = toy_robot()
    controller = PolicyController(
        load_actor(adding_actor(tmp_path / "a.onnx", spec, 6, states=()), robot, toy_motion()), robot
    )
    backwards = np.array([0.0, 0.0, 0.0, 1.0])  # looks along -x
    for quat in (UPRIGHT, backwards):
        controller.reset()
        np.testing.assert_allclose(act(controller, quat, reference=rows()).action, [1.0, 0.0, 0.0], atol=1e-6)
    # The robot drifts by +90 degrees afterwards: the reference's x axis lies along its -y.
    quarter_more = np.array([-HALF, 0.0, 0.0, HALF])
    np.testing.assert_allclose(act(controller, quarter_more, reference=rows()).action, [0.0, -1.0, 0.0], atol=1e-6)


def test_the_graphs_state_goes_from_tick_to_tick_and_is_forgotten(tmp_path):
    robot = toy_robot()
    path = adding_actor(tmp_path / "a.onnx", spec_of(ObservationTerm("dof_pos"), follows="commands"), 3)
    controller = PolicyController(load_actor(path, robot), robot)
    assert [act(controller).action[0] for _ in range(3)] == [0.0, 1.0, 2.0]
    controller.reset()
    assert act(controller).action.tolist() == [0.0, 0.0, 0.0]


def test_state_without_another_end_or_of_another_size_is_refused(tmp_path):
    robot, spec = toy_robot(), spec_of(ObservationTerm("dof_pos"), follows="commands")
    path = adding_actor(tmp_path / "a.onnx", spec, 3)
    model = onnx.load(str(path))
    del model.graph.output[0]
    onnx.save(model, str(path))
    with pytest.raises(InputError, match=r"state without its other end, got count, expected state.NAME and next_state"):
        load_actor(path, robot)


def test_a_command_rests_until_it_comes_and_after_its_time(tmp_path):
    robot = toy_robot()
    spec = spec_of(ObservationTerm("command", of="speed"), follows="commands", commands=(SPEED,))
    controller = PolicyController(load_actor(adding_actor(tmp_path / "a.onnx", spec, 3, states=()), robot), robot)
    wanted = np.array([0.5, -0.5, 0.25])
    assert act(controller).action.tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert act(controller, given={"speed": Given(wanted, 0.4)}).action.tolist() == wanted.tolist()
    beyond = Given(np.array([5.0, -5.0, 0.25]), 0.0)
    assert act(controller, given={"speed": beyond}).action.tolist() == [1.0, -1.0, 0.25]  # the range seen in training
    unknown = Given(np.array([np.nan, 0.0, 0.0]), 0.0)
    assert np.isnan(act(controller, given={"speed": unknown}).action).all()
    controller.reset()
    assert act(controller, given={"speed": Given(wanted, 0.6)}).action.tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert act(controller, given={"speed": Given(wanted, np.nan)}).action.tolist() == pytest.approx([0.1, 0.2, 0.3])


def test_an_old_or_missing_map_gives_no_action(tmp_path):
    robot = toy_robot()
    spec = spec_of(ObservationTerm("height_map", of="ground"), follows="commands", maps=(GROUND,))
    controller = PolicyController(load_actor(adding_actor(tmp_path / "a.onnx", spec, 3, states=()), robot), robot)
    heights = np.array([-0.25, 0.0, 3.0])
    assert act(controller, given={"ground": Given(heights, 0.05)}).action.tolist() == [-0.25, 0.0, 0.5]
    for given in ({}, {"ground": Given(heights, 0.2)}):
        controller.reset()
        assert np.isnan(act(controller, given=given).action).all()


def test_a_term_of_an_undeclared_command_is_refused(tmp_path):
    spec = spec_of(ObservationTerm("command", of="spead"), follows="commands", commands=(SPEED,))
    path = adding_actor(tmp_path / "a.onnx", spec, 3, states=())
    with pytest.raises(InputError, match=r"command: of: unknown name, got spead, expected speed"):
        load_actor(path, toy_robot())


def test_held_joints_stay_at_their_pose_with_their_gains(tmp_path):
    held = (HeldJoint("wrist", 0.7, 20.0, 1.5),)
    robot = toy_robot(("wrist", "ankle", "hip", "knee"))
    path = adding_actor(tmp_path / "a.onnx", spec_of(ObservationTerm("dof_pos"), follows="commands"), 3, states=())
    with pytest.raises(InputError, match="the actor lacks wrist"):
        load_actor(path, robot)
    spec = spec_of(ObservationTerm("dof_pos"), follows="commands", held_joints=held)
    controller = PolicyController(load_actor(adding_actor(path, spec, 3, states=()), robot), robot)
    q = np.array([9.0, 0.3, 0.1, 0.2])  # wrist, ankle, hip, knee
    output = controller.act(UPRIGHT, np.zeros(3), q, np.zeros(4), 0.0)
    np.testing.assert_allclose(output.target_rad, [0.7, 0.3, 0.1, 0.2], rtol=1e-6)
    assert output.kp.tolist() == [20.0, 40.0, 100.0, 150.0]
    assert output.kd.tolist() == [1.5, 0.1, 2.0, 4.0]
    np.testing.assert_allclose(output.action, [0.0, 0.3, 0.1, 0.2], rtol=1e-6)


def test_an_actor_that_follows_commands_takes_no_motion(tmp_path):
    path = adding_actor(tmp_path / "a.onnx", spec_of(ObservationTerm("dof_pos"), follows="commands"), 3, states=())
    with pytest.raises(InputError, match="follows commands, not a motion"):
        load_actor(path, toy_robot(), replace(toy_motion()))
