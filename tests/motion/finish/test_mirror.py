"""Mirror images by MuJoCo's own kinematics."""

import re
import shutil
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from core.errors import InputError
from motion.clip import Clip
from motion.finish import mirror_clip
from motion.finish.mirror import joint_mirror
from robot.robot import load_robot
from tests.robot.toy import TOY_YAML, load_toy
from world.scene import Box, Scene

ACROSS = np.diag([1.0, -1.0, 1.0])


@pytest.fixture(params=["g1", "toy"])
def any_robot(request, robot):
    return robot if request.param == "g1" else load_toy()


def random_clip(robot, seed: int = 0) -> Clip:
    rng = np.random.default_rng(seed)
    quat = rng.normal(size=(6, 4))
    return Clip(
        fps=30.0,
        joint_names=robot.joint_names,
        root_pos_w=rng.normal(size=(6, 3)),
        root_quat_wxyz=quat / np.linalg.norm(quat, axis=1, keepdims=True),
        joint_pos_rad=rng.uniform(robot.pos_lower_rad, robot.pos_upper_rad, (6, robot.num_joints)),
        contact=rng.uniform(size=(6, 2)),
    )


def places(robot, clip) -> dict[str, np.ndarray]:
    """Position (N,3) of every body's origin and centre of mass, by MuJoCo."""
    model = robot.model
    data = mujoco.MjData(model)
    columns = [clip.joint_names.index(name) for name in robot.joint_names]
    found = {name: [] for name in robot.body_names}
    for pos, quat, joints in zip(clip.root_pos_w, clip.root_quat_wxyz, clip.joint_pos_rad, strict=True):
        data.qpos[:] = np.concatenate([pos, quat, joints[columns]])
        mujoco.mj_kinematics(model, data)
        for name in robot.body_names:
            found[name].append(np.concatenate([data.body(name).xpos, data.body(name).xipos]))
    return {name: np.array(rows) for name, rows in found.items()}


def other_side(name: str) -> str:
    if name.startswith("left_"):
        return name.replace("left_", "right_", 1)
    return name.replace("right_", "left_", 1)


def test_every_body_is_where_a_mirror_shows_it(any_robot):
    clip = random_clip(any_robot)
    there, here = places(any_robot, clip), places(any_robot, mirror_clip(clip, any_robot))
    for name, place in here.items():
        expected = there[other_side(name)]
        np.testing.assert_allclose(place[:, :3], expected[:, :3] @ ACROSS, atol=1e-4, err_msg=name)  # the maker rounds
        np.testing.assert_allclose(place[:, 3:], expected[:, 3:] @ ACROSS, atol=6e-3, err_msg=name)  # as built


def test_contacts_change_sides(robot):
    clip = random_clip(robot)
    np.testing.assert_array_equal(mirror_clip(clip, robot).contact, clip.contact[:, ::-1])


def test_the_scene_is_mirrored_too(robot):
    """A place's height is found again on the other side, of turned boxes too; twice mirrored it is the same scene."""
    boxes = (Box((0.4, 0.3, 0.1), (0.3, 0.2, 0.1), 0.7), Box((-0.5, 0.0, 0.2), (0.2, 0.4, 0.1)))
    clip = replace(random_clip(robot), scene=Scene(0.05, boxes))
    xy_m = np.random.default_rng(2).uniform(-1.0, 1.0, (500, 2))
    mirrored = mirror_clip(clip, robot)
    heights = clip.scene.height_at(xy_m)
    assert len(set(heights)) == 3
    np.testing.assert_array_equal(mirrored.scene.height_at(xy_m * [1.0, -1.0]), heights)
    assert str(mirror_clip(mirrored, robot).scene) == str(clip.scene)  # as a text: -0.0 is not 0.0


def test_twice_mirrored_is_the_clip_itself(any_robot):
    clip = random_clip(any_robot)
    again = mirror_clip(mirror_clip(clip, any_robot), any_robot)
    for name in ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact"):
        np.testing.assert_allclose(getattr(again, name), getattr(clip, name), atol=1e-15)


def test_signs_of_the_g1(robot):
    """Pitch goes on as it is, roll and yaw turn round; the waist stays itself."""
    partner, sign = joint_mirror(robot)
    for joint, name in enumerate(robot.joint_names):
        assert robot.joint_names[partner[joint]] == other_side(name)
        assert sign[joint] == (1.0 if "pitch" in name or "knee" in name or "elbow" in name else -1.0), name


def test_joints_are_matched_by_name(robot):
    clip = random_clip(robot)
    order = np.random.default_rng(1).permutation(robot.num_joints)
    shuffled = Clip(
        fps=clip.fps,
        joint_names=tuple(np.array(robot.joint_names)[order].tolist()),
        root_pos_w=clip.root_pos_w,
        root_quat_wxyz=clip.root_quat_wxyz,
        joint_pos_rad=clip.joint_pos_rad[:, order],
        contact=clip.contact,
    )
    assert mirror_clip(shuffled, robot).sha256 == mirror_clip(clip, robot).sha256


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('name="left_leg" pos="0 0.1 -0.02"', 'name="left_leg" pos="0 0.12 -0.02"'), "left_hip and right_hip"),
        (('name="right_ankle" class="ankle"', 'name="right_ankle" axis="1 0 0" class="ankle"'), "left_ankle and"),
        (("right_ankle", "right_tarsus"), "expected a joint right_ankle"),
    ],
)
def test_a_lopsided_robot_is_refused(tmp_path, change, message):
    for file in TOY_YAML.parent.iterdir():
        shutil.copy(file, tmp_path / file.name)
    for file in ("toy.xml", "toy.yaml"):
        path = tmp_path / file
        path.write_text(path.read_text().replace(*change))
    toy = load_robot(tmp_path / "toy.yaml")
    with pytest.raises(InputError, match=re.escape(message)):
        joint_mirror(toy)
