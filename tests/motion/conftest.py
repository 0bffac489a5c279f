"""A small valid clip to start from, and the robot."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motion.author.cli import build_clip
from motion.clip import Clip
from robot.robot import Robot, load_robot
from tests.robot.toy import load_toy


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot()


@pytest.fixture(scope="session")
def lively_dance(robot: Robot) -> Clip:
    return build_clip(Path(__file__).with_name("lively_dance.yaml"), robot)


def clip_fields(num_frames: int = 5) -> dict:
    """Fields of a valid clip of two joints."""
    return {
        "fps": 30.0,
        "joint_names": ("hip", "knee"),
        "root_pos_w": np.arange(3.0 * num_frames).reshape(num_frames, 3) / 10.0,
        "root_quat_wxyz": np.tile([0.6, 0.0, 0.8, 0.0], (num_frames, 1)),
        "joint_pos_rad": np.linspace(-1.0, 1.0, 2 * num_frames).reshape(num_frames, 2),
        "contact": np.tile([1.0, 0.5], (num_frames, 1)),
        "source": "here",
        "license": "Apache-2.0",
        "created_by": "test",
    }


@pytest.fixture
def fields() -> dict:
    return clip_fields()


@pytest.fixture(scope="session")
def toy() -> Robot:
    """Of few joints, so that plots of them are soon drawn."""
    return load_toy()


def standing(robot: Robot, height_m: float) -> Callable[..., Clip]:
    """Builds a clip of `robot` in its default pose, its root so high, with the given fields replaced."""

    def build(num_frames: int = 31, fps: float = 30.0, **changes) -> Clip:
        values = {
            "root_pos_w": np.tile([0.0, 0.0, height_m], (num_frames, 1)),
            "root_quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (num_frames, 1)),
            "joint_pos_rad": np.tile(robot.default_pos_rad, (num_frames, 1)),
            "contact": np.ones((num_frames, 2)),
        }
        return Clip(fps=fps, joint_names=robot.joint_names, **(values | changes))

    return build


@pytest.fixture
def standing_clip(robot: Robot) -> Callable[..., Clip]:
    return standing(robot, 0.8)


@pytest.fixture
def toy_clip(toy: Robot) -> Callable[..., Clip]:
    return standing(toy, 0.485)
