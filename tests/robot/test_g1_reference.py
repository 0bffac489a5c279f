"""The G1's MJCF against the maker's published description."""

import mujoco
import numpy as np
import pytest

from core.rotations import quat_to_matrix
from robot.robot import load_robot
from tests.shared_data import SHARED, needs_shared_data
from world.model import compile_model

pytestmark = needs_shared_data

TIMESTEP_S = 0.002


@pytest.fixture(scope="module")
def robot():
    return load_robot()


@pytest.fixture(scope="module")
def ours(robot):
    return compile_model(robot, timestep_s=TIMESTEP_S)


@pytest.fixture(scope="module")
def reference():
    spec = mujoco.MjSpec.from_file(str(SHARED / "robot" / "g1_23dof_reference.xml"))
    spec.option.timestep = TIMESTEP_S
    return spec.compile()


def _bodies(robot, model):
    return [model.body(name).id for name in robot.body_names]


def _joints(robot, model):
    return [model.joint(name).id for name in robot.joint_names]


def _inertia(model, bodies):
    """(B, 3, 3) about the centre of mass, in the link's axes."""
    turn = quat_to_matrix(model.body_iquat[bodies])
    return np.einsum("bij,bj,bkj->bik", turn, model.body_inertia[bodies], turn)


def test_masses_and_inertias(robot, ours, reference):
    a, b = _bodies(robot, ours), _bodies(robot, reference)
    assert np.isclose(ours.body_mass.sum(), reference.body_mass.sum(), rtol=1e-6)
    assert np.allclose(ours.body_mass[a], reference.body_mass[b], rtol=1e-6, atol=0)
    assert np.abs(ours.body_ipos[a] - reference.body_ipos[b]).max() <= 1e-6
    expected = _inertia(reference, b)
    size = np.abs(expected).max((1, 2))
    assert (np.abs(_inertia(ours, a) - expected).max((1, 2)) <= 1e-6 * size).all()


def test_frames_and_tree(robot, ours, reference):
    a, b = _bodies(robot, ours), _bodies(robot, reference)
    assert a == b and np.array_equal(ours.body_parentid[a], reference.body_parentid[b])
    assert np.abs(ours.body_pos[a] - reference.body_pos[b]).max() <= 1e-6
    assert np.abs(quat_to_matrix(ours.body_quat[a]) - quat_to_matrix(reference.body_quat[b])).max() <= 1e-6


def test_joints(robot, ours, reference):
    a, b = _joints(robot, ours), _joints(robot, reference)
    fields = ("jnt_axis", "jnt_pos", "jnt_range", "jnt_actfrcrange", "jnt_bodyid", "jnt_limited")
    for field in fields:
        assert np.allclose(getattr(ours, field)[a], getattr(reference, field)[b], rtol=1e-6, atol=1e-9), field
    dof_a, dof_b = ours.jnt_dofadr[a], reference.jnt_dofadr[b]
    for field in ("dof_armature", "dof_frictionloss", "dof_damping"):
        assert np.allclose(getattr(ours, field)[dof_a], getattr(reference, field)[dof_b], rtol=1e-6), field
    names = [reference.joint(j).name for j in range(1, reference.njnt)]
    assert list(robot.joint_names) == names


def _held(robot, model, seconds):
    """Held in its default pose by PD, dropped from 2 cm: root height (T,) and pelvis x (T,)."""
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = 0.80, robot.default_pos_rad
    track = []
    for _ in range(round(seconds / TIMESTEP_S)):
        torque = robot.kp * (robot.default_pos_rad - data.qpos[7:]) - robot.kd * data.qvel[6:]
        data.ctrl[:] = np.clip(torque, -robot.torque_limit_nm, robot.torque_limit_nm)
        mujoco.mj_step(model, data)
        track.append(data.qpos[[2, 0]])
    return np.array(track)


def test_stands_like_the_real_soles(robot, ours, reference):
    mine, theirs = _held(robot, ours, 0.7), _held(robot, reference, 0.7)
    settled = slice(round(0.4 / TIMESTEP_S), None)
    assert np.abs(mine[settled] - theirs[settled]).max() < 2e-3
    assert np.abs(mine[settled, 0].max() - theirs[settled, 0].max()) < 2e-4


@pytest.mark.parametrize("side", ["left", "right"])
def test_sole_covers_the_real_one(robot, side):
    """>= 95 % of the real sole's area lies inside ours, and ours reaches no more than 6 mm beyond it."""
    foot = f"{side}_ankle_roll_link"
    vertices = _stl_vertices(SHARED / "robot" / "meshes" / f"{foot}.STL")
    lowest = vertices[:, 2].min()
    ours = robot.sole_points_m[foot]
    assert np.allclose(ours[:, 2], lowest, atol=2e-5)
    real = vertices[vertices[:, 2] < lowest + 2e-4][:, :2]
    x, y = np.meshgrid(np.linspace(-0.08, 0.16, 481), np.linspace(-0.05, 0.05, 201))
    grid = np.stack([x.ravel(), y.ravel()], 1)
    in_real, in_ours = _beyond_hull(grid, real) <= 0, _beyond_hull(grid, ours[:, :2]) <= 0
    assert (in_real & in_ours).sum() / in_real.sum() >= 0.95
    assert (in_ours & ~in_real).sum() / in_real.sum() <= 0.02
    assert _beyond_hull(ours[:, :2], real).max() < 0.006


def _stl_vertices(path):
    raw = path.read_bytes()
    count = int.from_bytes(raw[80:84], "little")
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    return np.frombuffer(raw, facet, count, 84)["corners"].reshape(-1, 3).astype(np.float64)


def _beyond_hull(points, corners):
    """How far (m) ``points`` lie outside the convex hull of ``corners``: its support in 720 directions."""
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    beyond = np.full(len(points), -np.inf)
    for out in np.stack([np.cos(angle), np.sin(angle)], axis=1):
        np.maximum(beyond, points @ out - (corners @ out).max(), out=beyond)
    return beyond
