"""Which actors a robot takes: those whose gains, scale, pose and period suit it."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from core.errors import InputError
from deploy.actors import check_bounds, check_start, load_run, reference_for
from motion.clip import clip_to_bytes
from policy.actor import bundled_actors, resolve_actor
from policy.inputs import MapSpec
from policy.layouts import LAYOUTS
from policy.metadata import read_metadata, write_metadata
from policy.observation import window_ticks
from policy.reference import window_at
from policy.spec import ObservationTerm, motion_info
from tests.deploy.toys import (
    JOINTS,
    KNEE,
    OBSERVATION,
    ROBOT,
    SETTINGS,
    SIZE,
    linear_run,
    still_clip,
    write_matrix_actor,
)
from tests.shared_data import SHARED, needs_shared_data
from tests.train.worlds import settings, swaying_clip, swaying_reference
from train.mdp.factory import build_environment


def one(values, factor, joint=KNEE):
    changed = values.copy()
    changed[joint] *= factor
    return changed


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    return linear_run(tmp_path_factory.mktemp("actor"))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kp": one(ROBOT.kp, 3.1)}, r"kp: .* left_knee_joint 465, expected a number in \[30, 450\]$"),
        ({"kp": one(ROBOT.kp, 0.19)}, r"kp: .* left_knee_joint 28.5"),
        ({"kd": ROBOT.kd * 50}, r"kd: .* left_hip_pitch_joint 100, .*\[0\.4, 6\]$"),
        ({"kd": one(ROBOT.kd, 0.0)}, r"kd: .* left_knee_joint 0, "),
        ({"default_pos_rad": one(ROBOT.default_pos_rad, 10.0)}, r"default_pos_rad: .* left_knee_joint 3, .*2\.8798\]$"),
        ({"control_period_s": 0.004}, r"control_period_s: .* got 0\.004"),
    ],
)
def test_what_does_not_suit_the_robot_is_refused_by_name(toy, change, says):
    run = object.__new__(type(toy))
    run.__dict__ |= toy.__dict__ | {"actor": replace(toy.actor, spec=replace(toy.actor.spec, **change))}
    with pytest.raises(InputError, match=r"toy\.onnx: " + says):
        check_bounds(run, ROBOT, SETTINGS.actor)


def test_what_nothing_would_give_it_is_refused(tmp_path):
    """An actor that waits for a map would be shown values that are no numbers."""
    heights = MapSpec("heights", (0.0, 0.1), (0.0,), 1.0, 0.5)
    group = replace(OBSERVATION, terms=(*OBSERVATION.terms, ObservationTerm("height_map", of="heights")))
    clip = still_clip(1.0)
    path, matrix = tmp_path / "seeing.onnx", np.zeros((SIZE + 2, JOINTS), dtype=np.float32)
    motion = motion_info(clip, "still", clip.joint_pos_rad[0])
    write_metadata(path, write_matrix_actor(path, matrix, group, motion=motion, maps=(heights,)), clip_to_bytes(clip))
    with pytest.raises(InputError, match=r"seeing\.onnx: .*more than a motion, got heights, expected no commands"):
        load_run(path, None, ROBOT, SETTINGS.entry)


@pytest.mark.parametrize(("off_rad", "taken"), [(0.14, True), (-0.14, True), (0.16, False), (-0.4, False)])
def test_a_motion_begins_where_the_robot_stands(tmp_path, off_rad, taken):
    stand = linear_run(tmp_path)
    pose_rad = ROBOT.default_pos_rad.copy()
    pose_rad[KNEE] += off_rad
    (tmp_path / "off").mkdir()
    run = linear_run(tmp_path / "off", pose_rad=pose_rad)
    if taken:
        check_start(run, stand, ROBOT, SETTINGS.entry)
        return
    says = f"motion toy: does not begin in the stand pose, got left_knee_joint {abs(off_rad):.2f} rad off it.*process"
    with pytest.raises(InputError, match=says):
        check_start(run, stand, ROBOT, SETTINGS.entry)


def test_the_ends_of_the_bounds_are_taken(toy):
    for factor in (0.2, 3.0):
        spec = replace(toy.actor.spec, kp=ROBOT.kp * factor, kd=ROBOT.kd * factor, action_scale=1.0)
        run = object.__new__(type(toy))
        run.__dict__ |= toy.__dict__ | {"actor": replace(toy.actor, spec=spec)}
        check_bounds(run, ROBOT, SETTINGS.actor)


@pytest.mark.parametrize("name", bundled_actors())
def test_bundled_actors_are_taken(name):
    follows = read_metadata(resolve_actor(name)).spec.follows
    check_bounds(
        load_run(name, "taichi" if follows == "any_clip" else None, ROBOT, SETTINGS.entry), ROBOT, SETTINGS.actor
    )


@needs_shared_data
def test_the_released_actor_is_taken():
    folder = SHARED / "pbhc"
    policy = folder / "actor_horse_stance_pose" / "model_50000.onnx"
    check_bounds(load_run(policy, folder / "Horse-stance_pose.pkl", ROBOT, SETTINGS.entry), ROBOT, SETTINGS.actor)


@pytest.mark.parametrize("layout", [name for name in LAYOUTS if name != "pbhc"])  # whose actors do not look ahead
def test_the_reference_that_a_robot_follows_is_that_of_training(toy, layout):
    """Every value of the window, at the clip's start, in its midst and beyond its end."""
    group = LAYOUTS[layout]()
    world = settings(observations=layout, critic=["history", "reference_position"])
    env = build_environment(world, ROBOT, swaying_reference(ROBOT), num_envs=1, seed=0, threads=1)
    spec = replace(toy.actor.spec, observations=(group,), follows="any_clip", motion=None)
    reference = reference_for(spec, swaying_clip(ROBOT), ROBOT)
    assert reference.steering is None or layout == "goals"
    points = None if reference.steering is None else ROBOT.tracked_index(ROBOT.goal_points)
    for tick in (0, 20, 70):
        ticks = window_ticks([group])
        trained = env.command.table.window(torch.tensor([0]), torch.tensor([tick]), ticks)
        deployed = window_at(reference, tick, ticks, np.arange(ROBOT.num_joints), points=points)
        for name, value in vars(deployed).items():
            if isinstance(value, np.ndarray):
                assert getattr(trained, name)[0].numpy() == pytest.approx(value, abs=1e-6), name
