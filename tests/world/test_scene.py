"""Floor and boxes: what MuJoCo makes of them, and what is refused."""

import dataclasses

import mujoco
import numpy as np
import pytest

from core.errors import InputError
from core.structured import parse
from hal.simulated.mujoco import MujocoBackend
from tests.hal.rigs import G1, UPRIGHT, SimulatedClock, hold, run, sim_options
from tests.robot.toy import load_toy
from world.model import build_spec, compile_model
from world.plant_model import build_plant_model
from world.scene import FLAT, MAX_BOXES, Box, Scene, add_scene

STEP = Scene(0.1, (Box((0.3, -0.2, 0.2), (0.4, 0.2, 0.15), 0.6),))


def model_of(scene: Scene, ball_at: tuple[float, float, float] | None = None) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    add_scene(spec, scene)
    if ball_at is not None:
        ball = spec.worldbody.add_body(name="ball", pos=ball_at)
        ball.add_freejoint()
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0], mass=1.0, condim=6, friction=[1, 0.1, 0.1])
    return spec.compile()


def after_s(model: mujoco.MjModel, seconds: float) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    return data


@pytest.mark.parametrize(("place", "top_m"), [((0.3, -0.2), 0.35), ((-1.0, 1.0), 0.1)])
def test_a_ball_rests_on_top_of_what_lies_under_it(place, top_m):
    data = after_s(model_of(STEP, (*place, 0.5)), 2.0)
    assert data.body("ball").xpos[2] - 0.05 == pytest.approx(top_m, abs=1e-3)
    assert STEP.height_at(np.array(place)) == pytest.approx(top_m)


def test_heights_are_where_rays_from_above_end():
    rng = np.random.default_rng(3)
    met = 0
    for _ in range(5):
        boxes = tuple(
            Box(tuple(rng.uniform(-0.5, 0.5, 3)), tuple(rng.uniform(0.05, 0.5, 3)), rng.uniform(-3.0, 3.0))
            for _ in range(4)
        )
        scene = Scene(rng.uniform(-0.2, 0.2), boxes)
        model = model_of(scene)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        places = rng.uniform(-1.0, 1.0, (20, 10, 2))
        found, down, geom = np.zeros((20, 10)), np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
        for index in np.ndindex(20, 10):
            above = np.array([*places[index], 5.0])
            found[index] = 5.0 - mujoco.mj_ray(model, data, above, down, None, 1, -1, geom)
            met += geom[0] > 0
        np.testing.assert_allclose(scene.height_at(places), found, atol=1e-9)
    assert 200 < met < 950


def test_a_scene_goes_to_plain_data_and_back():
    assert parse(Scene, dataclasses.asdict(STEP), "scene") == STEP
    assert parse(Scene, {}, "scene") == FLAT


GOOD = {"centre_m": [0, 0, 0], "half_size_m": [0.1, 0.2, 0.3]}
REFUSED = {
    "size zero": ({"boxes": [GOOD, GOOD | {"half_size_m": [0.1, 0.0, 0.3]}]}, r"scene\.boxes\[1\]\.half_size_m\[1\]"),
    "size negative": ({"boxes": [GOOD | {"half_size_m": [-1, 0.1, 0.3]}]}, r"scene\.boxes\[0\]\.half_size_m\[0\]"),
    "place nan": ({"boxes": [GOOD | {"centre_m": [0, 0, float("nan")]}]}, r"scene\.boxes\[0\]\.centre_m\[2\]: not fin"),
    "two numbers": ({"boxes": [GOOD | {"centre_m": [0, 0]}]}, r"scene\.boxes\[0\]\.centre_m: wrong length"),
    "yaw infinite": ({"boxes": [GOOD | {"yaw_rad": float("inf")}]}, r"scene\.boxes\[0\]\.yaw_rad: not finite"),
    "no size": ({"boxes": [{"centre_m": [0, 0, 0]}]}, r"scene\.boxes\[0\]\.half_size_m: missing key"),
    "degrees": ({"boxes": [GOOD | {"yaw_deg": 3}]}, r"scene\.boxes\[0\]\.yaw_deg: unknown key.*did you mean yaw_rad"),
    "floor text": ({"floor_m": "low"}, r"scene\.floor_m: wrong type.*a number in m"),
    "floor far": ({"floor_m": 1e9}, r"scene\.floor_m: out of range"),
    "too many": ({"boxes": [GOOD] * (MAX_BOXES + 1)}, rf"scene\.boxes: too many, got {MAX_BOXES + 1}"),
}


@pytest.mark.parametrize(("data", "message"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_scene_is_refused_by_its_full_path(data, message):
    with pytest.raises(InputError, match=f"^{message}"):
        parse(Scene, data, "scene")


def test_models_of_a_robot_hold_the_scene_and_the_flat_one_is_the_default():
    for model in (compile_model(G1, timestep_s=0.005, scene=STEP), build_plant_model(G1, sim_options(), scene=STEP)):
        assert model.geom("floor").pos[2] == 0.1
        np.testing.assert_array_equal(model.geom("box_0").size, STEP.boxes[0].half_size_m)
        np.testing.assert_array_equal(model.geom("box_0").friction, model.geom("floor").friction)
    assert compile_model(G1, timestep_s=0.005, scene=STEP).ngeom == compile_model(G1, timestep_s=0.005).ngeom + 1


PLATFORM = Scene(-0.2, (Box((0.0, 0.0, 0.05), (0.5, 0.5, 0.1)),))  # its top at 0.15 m


@pytest.mark.parametrize("gantry", [False, True])
def test_a_robot_begins_and_hangs_on_top_of_what_lies_under_it(gantry):
    roots = []
    for scene in (FLAT, Scene(-0.3), PLATFORM):
        with MujocoBackend(G1, SimulatedClock(), sim_options(), scene=scene, gantry=gantry) as backend:
            start_m = backend.read().truth.root_pos_w[2]
            state = run(backend, hold(G1), 0.3)
            assert state.truth.foot_contact.all()
            roots.append((start_m, state.truth.root_pos_w[2]))
    for above_m, root_m in zip((-0.3, 0.15), roots[1:]):
        np.testing.assert_allclose(root_m[0], roots[0][0] + above_m, atol=1e-9)
        np.testing.assert_allclose(root_m[1], roots[0][1] + above_m, atol=2e-3)


def test_another_model_gets_the_boxes_on_its_own_floor(tmp_path):
    robot = load_toy()
    path = tmp_path / "toy.xml"
    spec = build_spec(robot)
    spec.compile()
    path.write_text(spec.to_xml(), encoding="utf-8")
    boxes = Scene(boxes=PLATFORM.boxes)
    model = build_plant_model(robot, sim_options(), scene=boxes, sim_model=path)
    assert model.geom("box_0").pos.tolist() == [0.0, 0.0, 0.05]
    with pytest.raises(InputError, match=r"toy\.xml: a floor of another height, got -0\.2 m"):
        build_plant_model(robot, sim_options(), scene=PLATFORM, sim_model=path)


def test_a_scene_of_the_backend_is_what_its_robot_was_built_in():
    backend = MujocoBackend(G1, SimulatedClock(), sim_options(), scene=PLATFORM, gantry=False)
    assert backend.scene == PLATFORM
    with backend:
        backend.reset_to(np.array([2.0, 0.0, 0.6]), UPRIGHT, G1.default_pos_rad)  # beside the platform
        assert run(backend, hold(G1), 0.4).truth.root_pos_w[2] < 0.6
