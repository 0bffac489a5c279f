"""Rotations against scipy-free oracles: MuJoCo's own quaternion functions, and hand-computed turns."""

import mujoco
import numpy as np
import pytest
import torch

from core import rotations as rot

S = np.sqrt(0.5)


@pytest.fixture
def quats():
    rng = np.random.default_rng(3)
    q = rng.normal(size=(40, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


@pytest.fixture
def vectors():
    return np.random.default_rng(4).normal(size=(40, 3))


def _mujoco(function, size, *arguments):
    result = np.zeros((len(arguments[0]), size))
    for row, *values in zip(result, *arguments):
        function(row, *values)
    return result


def test_product_rotation_and_matrix_are_mujocos(quats, vectors):
    other = quats[::-1].copy()
    assert np.allclose(rot.quat_mul(quats, other), _mujoco(mujoco.mju_mulQuat, 4, quats, other), atol=1e-14)
    rotated = _mujoco(lambda out, q, v: mujoco.mju_rotVecQuat(out, v, q), 3, quats, vectors)
    assert np.allclose(rot.quat_rotate(quats, vectors), rotated, atol=1e-14)
    matrices = _mujoco(mujoco.mju_quat2Mat, 9, quats).reshape(-1, 3, 3)
    assert np.allclose(rot.quat_to_matrix(quats), matrices, atol=1e-14)


def test_inverse_rotation_undoes(quats, vectors):
    assert np.allclose(rot.quat_rotate_inverse(quats, rot.quat_rotate(quats, vectors)), vectors, atol=1e-14)
    one = rot.quat_mul(quats, rot.quat_conjugate(quats))
    assert np.allclose(one, [1, 0, 0, 0], atol=1e-14)


def test_axis_angle_and_rotvec_are_mujocos(quats):
    axes = rot.normalize(quats[:, 1:])
    angles = np.linspace(-3, 3, 40)
    expected = _mujoco(mujoco.mju_axisAngle2Quat, 4, axes, angles)
    assert np.allclose(rot.quat_from_axis_angle(axes, angles), expected, atol=1e-14)
    assert np.allclose(rot.quat_from_rotvec(axes * angles[:, None]), expected, atol=1e-12)
    vectors = _mujoco(lambda out, q: mujoco.mju_quat2Vel(out, q, 1.0), 3, quats)
    assert np.allclose(rot.quat_to_rotvec(quats), vectors, atol=1e-12)
    assert np.allclose(rot.quat_to_rotvec(-quats), vectors, atol=1e-12)


def test_small_turns_lose_nothing():
    for vector in ([0.0, 0.0, 0.0], [1e-9, 0, 0], [0, 3e-7, 1e-8]):
        assert np.allclose(rot.quat_to_rotvec(rot.quat_from_rotvec(np.array(vector))), vector, rtol=1e-9, atol=1e-20)


def test_quarter_turns_by_hand():
    about_z = np.array([S, 0, 0, S])
    assert np.allclose(rot.quat_rotate(about_z, np.array([1.0, 0, 0])), [0, 1, 0])
    assert np.isclose(rot.yaw_of(about_z), np.pi / 2)
    about_y = np.array([S, 0, S, 0])  # nose down: gravity then points along +x of the body
    assert np.allclose(rot.projected_gravity(about_y), [1, 0, 0])
    assert np.allclose(rot.projected_gravity(np.array([1.0, 0, 0, 0])), [0, 0, -1])


def test_projected_gravity_is_the_rotated_vector(quats):
    down = np.broadcast_to([0.0, 0, -1], (40, 3))
    assert np.allclose(rot.projected_gravity(quats), rot.quat_rotate_inverse(quats, down), atol=1e-14)


def test_yaw_is_where_the_x_axis_points(quats):
    x_axis = rot.quat_rotate(quats, np.broadcast_to([1.0, 0, 0], (40, 3)))
    assert np.allclose(rot.yaw_of(quats), np.arctan2(x_axis[:, 1], x_axis[:, 0]))
    heading = rot.yaw_quat(quats)
    assert np.allclose(rot.yaw_of(heading), rot.yaw_of(quats)) and np.allclose(heading[:, 1:3], 0)


def test_slerp_ends_middle_and_shorter_way():
    start, end = np.array([1.0, 0, 0, 0]), np.array([S, 0, 0, S])
    middle = [np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)]
    assert np.allclose(rot.quat_slerp(start, end, np.array(0.5)), middle)
    assert np.allclose(rot.quat_slerp(start, -end, np.array(0.5)), middle)
    assert np.allclose(rot.quat_slerp(start, end, np.array(0.0)), start)
    assert np.allclose(rot.quat_slerp(start, end, np.array(1.0)), end)


def test_sign_alignment(quats):
    aligned = rot.quat_align_sign(-quats, quats)
    assert np.array_equal(aligned, quats)


def test_torch_gives_numpys_numbers(quats, vectors):
    angles = np.linspace(-3, 3, 40)
    calls = {
        "mul": lambda q, v, a: rot.quat_mul(q, rot.quat_conjugate(q) + q),
        "rotate": lambda q, v, a: rot.quat_rotate(q, v),
        "inverse": lambda q, v, a: rot.quat_rotate_inverse(q, v),
        "matrix": lambda q, v, a: rot.quat_to_matrix(q),
        "axis": lambda q, v, a: rot.quat_from_axis_angle(rot.normalize(v), a),
        "rotvec": lambda q, v, a: rot.quat_from_rotvec(v),
        "to_rotvec": lambda q, v, a: rot.quat_to_rotvec(q),
        "yaw": lambda q, v, a: rot.yaw_quat(q),
        "gravity": lambda q, v, a: rot.projected_gravity(q),
        "align": lambda q, v, a: rot.quat_align_sign(q, q * a[..., None]),
        "slerp": lambda q, v, a: rot.quat_slerp(q, rot.yaw_quat(q), a),
        "cross": lambda q, v, a: rot.cross(v, q[..., 1:]),
    }
    for name, call in calls.items():
        result = call(torch.tensor(quats), torch.tensor(vectors), torch.tensor(angles))
        assert result.dtype == torch.float64, name
        assert np.allclose(result.numpy(), call(quats, vectors, angles), atol=1e-13), name


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_torch_gradients_at_exactly_zero(dtype):
    zero = torch.zeros(2, 3, dtype=dtype)
    slope = torch.autograd.functional.jacobian(lambda v: rot.quat_from_rotvec(v), zero)[1, :, 1]
    assert slope.tolist() == [[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]
    none = torch.tensor([1.0, 0, 0, 0], dtype=dtype)
    assert torch.autograd.functional.jacobian(rot.quat_to_rotvec, none)[:, 1:].tolist() == (2.0 * np.eye(3)).tolist()
    assert torch.autograd.functional.jacobian(rot.normalize, zero).isfinite().all()
    assert not rot.normalize(zero).any() and not rot.quat_to_rotvec(none).any()
