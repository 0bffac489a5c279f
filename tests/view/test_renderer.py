"""Pictures: the software renderer against OpenGL's, the ghost, and how a backend is chosen."""

from contextlib import closing

import mujoco
import numpy as np
import pytest

from core.errors import InputError
from robot.robot import load_robot
from tests.robot.toy import load_toy
from view import camera
from view import renderer as choice
from view.renderer import open_renderer
from view.software import SoftwareRenderer
from world.model import compile_model
from world.scene import Scene

WIDTH, HEIGHT = 320, 240


@pytest.fixture(scope="module")
def g1():
    robot = load_robot()
    model = compile_model(robot, timestep_s=0.005)
    data = mujoco.MjData(model)
    data.qpos[:3], data.qpos[7:] = [3.0, -2.0, 0.778], robot.default_pos_rad
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(autouse=True)
def fresh_choice(monkeypatch):
    monkeypatch.delenv("KATA_RENDERER", raising=False)
    choice._say_what_to_install.cache_clear()


def _picture(model, data, backend, monkeypatch, **options):
    monkeypatch.setenv("KATA_RENDERER", backend)
    with closing(open_renderer(model, WIDTH, HEIGHT)) as renderer:
        return renderer.render(data, **options)


def _without_robot(model, data):
    """The same place with the robot lifted out of sight."""
    empty = mujoco.MjData(model)
    empty.qpos[:] = data.qpos
    empty.qpos[2] += 100.0
    mujoco.mj_forward(model, empty)
    return empty


def _silhouette(model, data, backend, monkeypatch):
    """Pixels that the robot changes, its shadow apart: what differs in more than brightness."""
    with_robot = _picture(model, data, backend, monkeypatch).astype(int)
    without = _picture(model, _without_robot(model, data), backend, monkeypatch).astype(int)
    return np.abs(with_robot - without).max(-1) > 6


def test_software_draws_the_robot_where_opengl_does(g1, monkeypatch):
    if not choice._works("egl"):
        pytest.skip("no EGL on this machine")
    model, data = g1
    shape, expected = (_silhouette(model, data, backend, monkeypatch) for backend in ("software", "egl"))
    upper = slice(0, HEIGHT // 2)  # above the shadow on the floor
    shape, expected = shape[upper], expected[upper]
    assert expected.sum() > 800
    assert (shape & expected).sum() / (shape | expected).sum() > 0.9


@pytest.mark.parametrize("backend", ["software", "egl"])
def test_ghost_shows_beside_and_through_nothing(g1, backend, monkeypatch):
    if backend == "egl" and not choice._works("egl"):
        pytest.skip("no EGL on this machine")
    model, data = g1
    ghost = data.qpos.copy()
    ghost[1] += 0.6
    plain = _picture(model, data, backend, monkeypatch).astype(int)
    haunted = _picture(model, data, backend, monkeypatch, ghost_qpos=ghost).astype(int)
    changed = np.abs(plain - haunted).max(-1) > 8
    assert 0.01 < changed.mean() < 0.2
    blue = haunted[changed][:, 2] - haunted[changed][:, 0]
    assert np.median(blue) > 15
    assert plain.dtype == haunted.dtype and plain.shape == (HEIGHT, WIDTH, 3)


def test_camera_is_mujocos_and_follows(g1, monkeypatch):
    model, data = g1
    for name, value in (("AZIMUTH_DEG", 120.0), ("ELEVATION_DEG", -25.0), ("DISTANCE_M", 3.1)):
        monkeypatch.setattr(camera, name, value)
    scene = mujoco.MjvScene(model, maxgeom=500)
    option, everything = mujoco.MjvOption(), mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(model, data, option, mujoco.MjvPerturb(), camera.free_camera(data), everything, scene)
    left, right = scene.camera
    position, rotation = camera.camera_pose(data)
    assert np.allclose((left.pos + right.pos) / 2, position, atol=1e-5)
    assert np.allclose(-rotation[:, 2], left.forward, atol=1e-5) and np.allclose(rotation[:, 1], left.up, atol=1e-5)
    assert np.allclose(camera.lookat_m(data), [3.0, -2.0, 0.66])


@pytest.mark.parametrize("backend", ["software", "egl"])
def test_on_a_higher_floor_everything_looks_the_same(g1, backend, monkeypatch):
    if backend == "egl" and not choice._works("egl"):
        pytest.skip("no EGL on this machine")
    model, data = g1
    higher = compile_model(load_robot(), timestep_s=0.005, scene=Scene(1.5))
    lifted = mujoco.MjData(higher)
    lifted.qpos[:] = data.qpos
    lifted.qpos[2] += 1.5
    mujoco.mj_forward(higher, lifted)
    pictures = [_picture(*place, backend, monkeypatch).astype(int) for place in ((model, data), (higher, lifted))]
    assert (np.abs(pictures[0] - pictures[1]).max(-1) > 8).mean() < 0.01


def test_a_robot_out_of_sight_or_behind_leaves_an_empty_scene(g1, monkeypatch):
    model, data = g1
    monkeypatch.setattr(camera, "lookat_m", lambda data: np.array([200.0, 0.0, 0.66]))
    picture = _picture(model, data, "software", monkeypatch)
    assert picture.min() > 100  # floor and sky are pale, the robot is partly black


def test_any_model_can_be_drawn(monkeypatch):
    model = compile_model(load_toy(), timestep_s=0.005)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    monkeypatch.setattr(camera, "DISTANCE_M", 2.0)
    monkeypatch.setattr(camera, "HEIGHT_M", 0.4)
    picture = _picture(model, data, "software", monkeypatch)
    orange = (picture[..., 0].astype(int) - picture[..., 2]) > 60
    assert orange.sum() > 500


def test_a_bare_model_can_be_drawn(monkeypatch):
    """Without shapes to see there are still floor and sky."""
    model = compile_model(load_robot(), timestep_s=0.005, strip_visuals=True)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert _picture(model, data, "software", monkeypatch).std() > 5


def test_meshes_are_drawn_with_their_shadows_and_shapes_without_colour_are_not(monkeypatch):
    mesh = '<asset><mesh name="tetra" vertex="0 0 0  .4 0 0  0 .4 0  0 0 .4"/></asset>'
    floor = '<geom type="plane" size="0 0 .1"/>'
    pictures = []
    for alpha in (0.0, 1.0):
        robot = f'<body pos="0 0 .6"><freejoint/><geom type="mesh" mesh="tetra" rgba="1 .2 0 {alpha}"/></body>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco>{mesh}<worldbody>{floor}{robot}</worldbody></mujoco>")
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        pictures.append(_picture(model, data, "software", monkeypatch).astype(int))
    orange = pictures[1][..., 0] - pictures[1][..., 2] > 60
    darker = (pictures[0] - pictures[1]).min(-1) > 20
    assert orange.sum() > 300 and (darker & ~orange)[HEIGHT // 2 :].sum() > 100
    assert pictures[0].min() > 100


def test_without_opengl_software_draws_and_says_once_what_to_install(g1, monkeypatch, capsys):
    monkeypatch.setattr(choice, "_works", lambda backend: False)
    model, _ = g1
    for _ in range(2):
        assert isinstance(open_renderer(model, 64, 48), SoftwareRenderer)
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "libegl1" in said and "libosmesa6" in said


def test_mujoco_gl_chooses_what_is_tried_first(monkeypatch):
    tried = []
    monkeypatch.setattr(choice, "_works", lambda backend: tried.append(backend) or backend == "egl")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert choice.choose_backend() == "egl" and tried == ["osmesa", "egl"]


def test_a_forced_backend_is_not_replaced(g1, monkeypatch):
    monkeypatch.setattr(choice, "_works", lambda backend: False)
    monkeypatch.setenv("KATA_RENDERER", "egl")
    with pytest.raises(InputError, match="renderer does not work here, got egl"):
        open_renderer(g1[0], 64, 48)
    monkeypatch.setenv("KATA_RENDERER", "vulkan")
    with pytest.raises(InputError, match="unknown renderer, got vulkan, expected egl, osmesa, software"):
        open_renderer(g1[0], 64, 48)


def test_a_picture_needs_pixels(g1):
    with pytest.raises(InputError, match="picture size, got 0 x 48"):
        open_renderer(g1[0], 0, 48)
