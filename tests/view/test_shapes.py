"""Every shape of the software renderer against MuJoCo's own ray casting."""

import mujoco
import numpy as np
import pytest

from view.shapes import SHAPES
from view.triangles import meet_mesh

SIZES = {
    "sphere": [0.3, 0, 0],
    "capsule": [0.15, 0.3, 0],
    "ellipsoid": [0.3, 0.15, 0.22],
    "cylinder": [0.2, 0.3, 0],
    "box": [0.25, 0.1, 0.3],
}


def _model(geom):
    mesh = '<asset><mesh name="tetra" vertex="0 0 0  .4 0 0  0 .4 0  0 0 .4"/></asset>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{mesh}<worldbody>{geom}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _rays(count, spread):
    rng = np.random.default_rng(5)
    eye = rng.normal(size=(count, 3))
    eye *= 1.5 / np.linalg.norm(eye, axis=1, keepdims=True)
    direction = spread * rng.normal(size=(count, 3)) - eye
    return eye, direction / np.linalg.norm(direction, axis=1, keepdims=True)


@pytest.mark.parametrize("kind", SIZES)
def test_distance_and_normal_are_mujocos(kind):
    model, data = _model(f'<geom type="{kind}" size="{" ".join(map(str, SIZES[kind]))}"/>')
    eye, direction = _rays(400, 0.25)
    t, normal = SHAPES[int(model.geom_type[0])](eye.T, direction.T, np.array(SIZES[kind], dtype=float))
    normal = normal / np.maximum(np.linalg.norm(normal, axis=0), 1e-12)
    hits = 0
    for i in range(len(eye)):
        expected_normal = np.zeros(3)
        expected = mujoco.mj_ray(model, data, eye[i], direction[i], None, 1, -1, np.zeros(1, np.int32), expected_normal)
        assert np.isfinite(t[i]) == (expected >= 0)
        if expected >= 0:
            hits += 1
            assert np.isclose(t[i], expected, atol=1e-5)
            assert np.allclose(normal[:, i], expected_normal, atol=1e-3)
    assert 100 < hits < 400


def test_mesh_triangles_are_mujocos():
    model, data = _model('<geom type="mesh" mesh="tetra"/>')
    focal_px, height, width = 60.0, 40, 50
    eye = np.array([0.9, 0.8, 0.5])
    back = eye / np.linalg.norm(eye)
    right = np.cross([0, 0, 1.0], back)
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(back, right), back])
    x = (np.arange(width) + 0.5 - width / 2) / focal_px
    y = (height / 2 - np.arange(height) - 0.5) / focal_px
    rays = np.stack(np.broadcast_arrays(x[None], y[:, None], -1.0))
    rays = np.tensordot(turn.T, rays / np.linalg.norm(rays, axis=0), 1)
    place, local = data.geom_xpos[0], data.geom_xmat[0].reshape(3, 3)
    t, _ = meet_mesh(model, 0, local.T @ (eye - place)[:, None], np.tensordot(local.T, rays, 1), turn @ local, focal_px)
    expected = np.array(
        [
            mujoco.mj_ray(model, data, eye, ray, None, 1, -1, np.zeros(1, np.int32), None)
            for ray in rays.reshape(3, -1).T
        ]
    )
    seen, hit = np.isfinite(t), expected >= 0
    assert hit.sum() > 100 and (seen != hit).sum() <= 0.03 * hit.sum()  # an edge may fall to either side
    both = seen & hit
    assert np.abs(t[both] - expected[both]).max() < 1e-3
