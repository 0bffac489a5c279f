"""Records of small clips."""

from collections.abc import Callable

import pytest

from motion.clip import Clip
from motion.report.record import Record
from robot.robot import Robot
from tests.motion.report.verdicts import verdict_of


@pytest.fixture
def record_of(robot: Robot) -> Callable[..., Record]:
    """Builds a record of a robot's clip, written as it is, with the given fields replaced."""

    def build(motion: Clip, **changes) -> Record:
        values = {
            "name": "walk<1>",
            "robot": robot,
            "file": "walk.csv",
            "sha256": "ab" * 32,
            "options": {"loop": True},
            "settings_sha256": "cd" * 32,
            "notes": ("assumed so",),
            "before": motion,
            "input_verdict": verdict_of(motion.num_frames),
            "after": motion,
            "clip": motion,
            "clip_verdict": verdict_of(motion.num_frames),
        }
        return Record(**(values | changes))

    return build
