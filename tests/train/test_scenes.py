"""A stepping clip on two boxes of 5 cm, one under the path of each foot: in training and in HAL's plant."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from core.errors import InputError
from hal.simulated.mujoco import MujocoBackend
from motion.clip import load_clip, save_clip
from motion.feet import ground_lift_m
from motion.library import open_motion
from motion.reference import Reference, build_reference
from motion.tables import with_tables
from policy.reference import window_at
from tests.hal.rigs import SimulatedClock, hold, run, sim_options
from tests.train.worlds import g1, settings, swaying_clip
from train.mdp.evaluator import fall_height_m
from train.mdp.factory import build_environment
from train.mdp.tick import ReferenceTable
from train.simulation.domain import DomainRanges
from train.simulation.model import SimulationSettings
from train.simulation.mujoco_cpu import MujocoCpuSimulator
from world.scene import Box, Scene

# The left sole of `steps` stays within x -0.22 to 0.25 m, y 0.02 to 0.22 m; the right one mirrors it.
BOXES = Scene(boxes=tuple(Box((0.015, side * 0.1185, 0.025), (0.26, 0.11, 0.025)) for side in (1.0, -1.0)))
TOP_M = 0.05
RAISED = Scene(0.4)
PLATFORM = Scene(boxes=(Box((5.0, 0.0, 0.2), (1.0, 1.0, 0.2)),))  # its top at 0.4 m
TICKS = 10


@pytest.fixture(scope="module")
def start() -> np.ndarray:
    """qpos of the first frame of a file of `steps` with the boxes, lifted onto them."""
    clip = replace(open_motion("steps", g1()), scene=BOXES)
    reference = build_reference(clip, g1())
    lift_m = ground_lift_m(g1(), reference)
    assert lift_m == pytest.approx(TOP_M, abs=1e-6)  # flat feet on the ground throughout, never beside the boxes
    root_pos_w = reference.root_pos_w[0] + [0.0, 0.0, lift_m[0]]
    return np.concatenate([root_pos_w, reference.root_quat_wxyz[0], reference.joint_pos_rad[0]])


def assert_on_the_boxes(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Each foot touches its own box and nothing else; its sole lies at 5 cm."""
    for foot, box in zip(g1().feet, ("box_0", "box_1")):
        pairs = model.geom_bodyid[data.contact.geom], data.contact.geom
        on = {int(geom[1 - side]) for body, geom in zip(*pairs) for side in (0, 1) if body[side] == model.body(foot).id}
        assert on == {model.geom(box).id}
        points_w = data.body(foot).xpos + g1().sole_points_m[foot] @ data.body(foot).xmat.reshape(3, 3).T
        assert points_w[:, 2] == pytest.approx(TOP_M, abs=5e-3)


def simulator(scene: Scene, num_envs: int) -> MujocoCpuSimulator:
    generators = (torch.Generator().manual_seed(stream) for stream in range(2))
    return MujocoCpuSimulator(g1(), num_envs, DomainRanges(), *generators, scene=scene, settings=SimulationSettings())


def test_feet_stand_on_the_boxes_in_training(start):
    sim = simulator(BOXES, 1)
    sim.reset(torch.arange(1), torch.tensor(start)[None], torch.zeros(1, 29))
    for _ in range(TICKS):
        sim.step(torch.tensor(g1().default_pos_rad).float()[None])
    assert float(sim.state().foot_force_w[..., 2].sum()) == pytest.approx(33.34114 * 9.81, rel=0.1)
    model = sim._models[0]
    data = mujoco.MjData(model)
    data.qpos[:] = sim._state[0, 1 : 1 + model.nq]
    mujoco.mj_forward(model, data)
    assert_on_the_boxes(model, data)


def test_feet_stand_on_the_boxes_in_the_simulated_backend(start):
    with MujocoBackend(g1(), SimulatedClock(), sim_options(), scene=BOXES, gantry=False) as backend:
        backend.reset_to(start[:3], start[3:7], start[7:])
        assert run(backend, hold(g1()), TICKS * 0.02).truth.foot_contact.all()
        assert_on_the_boxes(backend.model, backend.data)


def test_a_scene_travels_in_the_clip_to_the_environment(tmp_path):
    save_clip(replace(open_motion("steps", g1()), scene=BOXES), tmp_path / "boxes.npz")
    reference = build_reference(load_clip(tmp_path / "boxes.npz"), g1())
    env = build_environment(settings(), g1(), reference, num_envs=2, seed=0, threads=1)
    assert env.simulator._models[0].geom("box_1").pos.tolist() == [0.015, -0.1185, 0.025]


def test_a_fall_is_one_above_what_the_robot_stands_on():
    """A share of 0.4 of how high the lowest of the roots begins above it."""
    low, high = (replace(swaying_clip(g1()), root_pos_w=np.tile([0.0, 0.0, z], (51, 1))) for z in (0.7, 0.8))
    assert fall_height_m(*(build_reference(clip, g1()) for clip in (low, high))) == pytest.approx(0.28)
    on_a_box = Scene(-1.0, (Box((0.0, 0.0, 0.0), (0.5, 0.5, 0.3)),))
    for scene, height_m in ((Scene(-1.0), 0.4 * 1.8), (on_a_box, 0.4 * 0.5)):
        assert fall_height_m(build_reference(replace(high, scene=scene), g1())) == pytest.approx(height_m)


def raised(scene: Scene, x_m: float = 0.0) -> Reference:
    """The swaying clip at x_m on ground at 0.4 m: its root is 0.78 m above that."""
    clip = swaying_clip(g1())
    return build_reference(replace(clip, root_pos_w=clip.root_pos_w + np.array([x_m, 0.0, 0.4]), scene=scene), g1())


@pytest.mark.parametrize("scene", [RAISED, PLATFORM])
@pytest.mark.parametrize(("least_m", "fails"), [(0.7, False), (0.9, True)])
def test_training_ends_an_episode_by_the_height_above_what_the_robot_stands_on(scene, least_m, fails):
    """Standing its pelvis is at 1.18 m in the world."""
    rule = {"terms": {"height": {"min_m": least_m}}, "max_episode_s": 10.0}
    env = build_environment(settings(termination=rule), g1(), raised(scene, 5.0), num_envs=2, seed=0, threads=1)
    env.reset()
    assert env.step(torch.zeros(2, 23)).terminated.tolist() == [fails, fails]


def test_an_actor_sees_heights_above_the_floor_in_training_and_on_the_robot():
    """The pelvis is 0.78 m above a floor at 0.4 m, and so on a box it is 1.18 m above one at 0."""
    hand = [g1().tracked_names.index("left_hand_link")]
    for scene, height_m in ((RAISED, 0.78), (PLATFORM, 1.18)):
        reference = with_tables(g1(), raised(scene, 5.0), {"steering"})
        table = ReferenceTable([reference], [np.zeros(reference.num_ticks + 1)], "cpu", hand)
        trained = table.window(torch.tensor([0]), torch.tensor([3]), (1, 2))
        robot = window_at(reference, 3, (1, 2), np.arange(23), points=np.array(hand), visible=np.ones(1))
        above_pelvis_m = reference.body_pos_w[4, hand[0], 2] - 1.18
        for window, first in ((trained, 0), (robot, slice(None))):
            assert np.asarray(window.root_height_m)[first] == pytest.approx([height_m] * 2, abs=1e-6)
            points_m = np.asarray(window.points_m)[first]
            assert points_m[0, 0, 2] == pytest.approx(height_m + above_pelvis_m, abs=1e-6)
            assert abs(points_m[0, 0, 0]) < 0.5  # from the root, not from the origin


def test_clips_of_different_scenes_are_refused():
    clip = swaying_clip(g1())
    references = {"plain": build_reference(clip, g1()), "boxes": build_reference(replace(clip, scene=BOXES), g1())}
    with pytest.raises(InputError, match="clips of different scenes, got plain, boxes, expected one scene for all"):
        build_environment(settings(), g1(), references, num_envs=2, seed=0, threads=1)
