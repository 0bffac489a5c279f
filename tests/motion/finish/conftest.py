"""A motion on one leg, written down beside the tests."""

from pathlib import Path

import pytest

from motion.author.cli import build_clip
from motion.clip import Clip


@pytest.fixture(scope="session")
def high_kick(robot) -> Clip:
    return build_clip(Path(__file__).with_name("high_kick.yaml"), robot)
