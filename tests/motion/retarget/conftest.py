"""Settings of retargeting for the robots of the tests."""

from pathlib import Path

import pytest

from motion.retarget.settings import RetargetSettings, load_settings
from robot.robot import Robot
from tests.robot.toy import load_toy

TOY_SETTINGS = Path(__file__).parent / "toy.yaml"


@pytest.fixture(scope="session")
def settings(robot: Robot) -> RetargetSettings:
    return load_settings(robot)


@pytest.fixture(scope="session")
def toy() -> Robot:
    return load_toy()


@pytest.fixture(scope="session")
def toy_settings(toy: Robot) -> RetargetSettings:
    return load_settings(toy, TOY_SETTINGS)
