"""Forward kinematics against MuJoCo and against finite differences."""

import mujoco
import numpy as np
import pytest
import torch

from core.errors import InputError
from core.rotations import quat_from_rotvec, quat_mul, quat_rotate_inverse, quat_to_rotvec
from robot.kinematics import Kinematics
from robot.robot import load_robot
from tests.robot.toy import load_toy
from world.model import compile_model


@pytest.fixture(scope="module", params=["g1", "toy"])
def robot(request):
    return load_robot() if request.param == "g1" else load_toy()


def _states(robot, count=12):
    rng = np.random.default_rng(11)
    quat = rng.normal(size=(count, 4))
    return (
        rng.normal(size=(count, 3)),
        quat / np.linalg.norm(quat, axis=1, keepdims=True),
        rng.uniform(robot.pos_lower_rad, robot.pos_upper_rad, size=(count, robot.num_joints)),
        rng.normal(size=(count, 3)),
        3.0 * rng.normal(size=(count, 3)),
        10.0 * rng.normal(size=(count, robot.num_joints)),
    )


def _mujoco_state(robot, model, pos, quat, joints, lin_vel, ang_vel, joint_vel):
    """World position, quaternion, linear and angular velocity of every tracked point, by MuJoCo."""
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([pos, quat, joints])
    data.qvel[:] = np.concatenate([lin_vel, quat_rotate_inverse(quat, ang_vel), joint_vel])
    mujoco.mj_forward(model, data)
    rows = []
    for name in robot.tracked_names:
        kind, index = mujoco.mjtObj.mjOBJ_XBODY, None
        if name in robot.body_names:
            index = model.body(name).id
            place, turn = data.xpos[index], data.xquat[index]
        else:
            kind, index = mujoco.mjtObj.mjOBJ_SITE, model.site(name).id
            place, turn = data.site_xpos[index], data.xquat[model.site_bodyid[index]]
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, kind, index, velocity, 0)
        rows.append((place.copy(), turn.copy(), velocity[3:], velocity[:3]))
    return [np.array(column) for column in zip(*rows)] + [data.subtree_com[1].copy()]


def _with_point_sites(robot):
    def add(spec):
        for point in robot.points:
            spec.body(point.parent).add_site(name=point.name, pos=point.offset_m)

    return compile_model(robot, timestep_s=0.005, edit=add)


def test_agrees_with_mujoco(robot):
    model = _with_point_sites(robot)
    kinematics = robot.kinematics
    states = _states(robot)
    bodies = kinematics.forward(*states)
    com = kinematics.center_of_mass_of(bodies)
    for i, state in enumerate(zip(*states)):
        pos, quat, lin_vel, ang_vel, expected_com = _mujoco_state(robot, model, *state)
        assert np.abs(bodies.pos_w[i] - pos).max() < 1e-9
        assert np.abs(np.abs((bodies.quat_wxyz[i] * quat).sum(-1)) - 1).max() < 1e-9
        assert np.abs(bodies.lin_vel_w[i] - lin_vel).max() < 1e-9
        assert np.abs(bodies.ang_vel_w[i] - ang_vel).max() < 1e-9
        assert np.abs(com[i] - expected_com).max() < 1e-9


def test_velocities_are_the_derivatives_of_the_poses(robot):
    kinematics, h = robot.kinematics, 1e-5
    pos, quat, joints, lin_vel, ang_vel, joint_vel = _states(robot)
    bodies = kinematics.forward(pos, quat, joints, lin_vel, ang_vel, joint_vel)
    after, before = (
        kinematics.forward(pos + s * lin_vel, quat_mul(quat_from_rotvec(s * ang_vel), quat), joints + s * joint_vel)
        for s in (h, -h)
    )
    assert np.allclose((after.pos_w - before.pos_w) / (2 * h), bodies.lin_vel_w, atol=1e-5)
    conjugate = before.quat_wxyz * np.array([1.0, -1, -1, -1])
    turned = quat_to_rotvec(quat_mul(after.quat_wxyz, conjugate))
    assert np.allclose(turned / (2 * h), bodies.ang_vel_w, atol=1e-5)


def test_torch_agrees_and_keeps_its_type(robot):
    kinematics, states = robot.kinematics, _states(robot)
    expected = kinematics.forward(*states)
    for dtype, tolerance in ((torch.float64, 1e-12), (torch.float32, 2e-4)):
        got = kinematics.forward(*(torch.tensor(s, dtype=dtype) for s in states))
        for field, exact in zip(got, expected):
            assert field.dtype == dtype and field.is_contiguous()
            assert np.abs(field.numpy() - exact).max() < tolerance


def test_single_precision_stays_single(robot):
    kinematics, states = robot.kinematics, _states(robot)
    exact = kinematics.forward(*states)
    for field, expected in zip(kinematics.forward(*(s.astype(np.float32) for s in states)), exact):
        assert field.dtype == np.float32 and field.flags.c_contiguous
        assert np.abs(field - expected).max() < 2e-4


def test_angles_in_whole_numbers_leave_the_model_as_it_is(robot):
    kinematics, root = robot.kinematics, (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    whole = np.arange(len(robot.joint_names)) % 2
    for field, expected in zip(kinematics.forward(*root, whole)[:2], kinematics.forward(*root, whole.astype(float))):
        assert np.array_equal(field, expected)


def test_any_leading_dimensions(robot):
    kinematics, states = robot.kinematics, _states(robot)
    flat = kinematics.forward(*states)
    folded = kinematics.forward(*(s.reshape(3, 4, -1) for s in states))
    single = kinematics.forward(*(s[5] for s in states))
    points = len(robot.tracked_names)
    assert folded.pos_w.shape == (3, 4, points, 3) and single.quat_wxyz.shape == (points, 4)
    assert np.array_equal(folded.lin_vel_w.reshape(flat.lin_vel_w.shape), flat.lin_vel_w)
    assert np.allclose(single.ang_vel_w, flat.ang_vel_w[5], atol=1e-14)
    assert kinematics.center_of_mass_of(single).shape == (3,)


def test_without_velocities_there_are_none(robot):
    bodies = robot.kinematics.forward(*_states(robot)[:3])
    assert bodies.lin_vel_w is None and bodies.ang_vel_w is None


def test_gradients_pass_through(robot):
    state = [torch.tensor(s) for s in _states(robot)[:3]]
    state[2].requires_grad_()
    robot.kinematics.forward(*state).pos_w.sum().backward()
    assert torch.isfinite(state[2].grad).all() and state[2].grad.abs().max() > 0


def test_a_joint_beside_its_body_is_refused(tmp_path):
    toy = load_toy()
    path = tmp_path / "toy.xml"
    path.write_text(toy.mjcf_path.read_text().replace('name="left_hip"', 'name="left_hip" pos="0 0 0.1"'))
    model = mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(InputError, match="do not fit forward kinematics"):
        Kinematics(model, toy.points, where=str(path))
