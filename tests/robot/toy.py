"""The second, smaller robot of the tests."""

from pathlib import Path

from robot.robot import Robot, load_robot

TOY_YAML = Path(__file__).parent / "fixtures" / "toy.yaml"


def load_toy() -> Robot:
    return load_robot(TOY_YAML)
