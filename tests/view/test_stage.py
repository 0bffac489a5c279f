"""Poses as pictures."""

import numpy as np

from tests.robot.toy import load_toy
from view.stage import Stage


def test_the_picture_shows_the_pose(monkeypatch):
    monkeypatch.setenv("KATA_RENDERER", "software")
    robot = load_toy()
    standing = np.zeros(7 + robot.num_joints)
    standing[[2, 3]] = 1.0
    bent = standing.copy()
    bent[7:] = 0.5
    with Stage(robot, 64, 48) as stage:
        first, second, again = (stage.picture(pose) for pose in (standing, bent, standing))
    assert first.shape == (48, 64, 3) and first.dtype == np.uint8
    assert np.array_equal(first, again)
    assert (first != second).any()
