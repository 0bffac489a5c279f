"""Poses as pictures."""

import numpy as np

from tests.robot.toy import load_toy
from view.stage import Stage
from world.scene import Box, Scene


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


def test_the_scene_is_in_the_picture(monkeypatch):
    """A robot a metre higher, on a floor a metre higher, looks the same; a box beside it is seen, and is no ghost's."""
    monkeypatch.setenv("KATA_RENDERER", "software")
    robot = load_toy()
    pose = np.zeros(7 + robot.num_joints)
    pose[[2, 3]] = 1.0
    raised = pose.copy()
    raised[2] += 1.0
    beside = Scene(1.0, (Box((0.0, 0.6, 1.2), (0.2, 0.2, 0.2)),))
    pictures = []
    for where, scene in ((pose, Scene()), (raised, Scene(1.0)), (raised, beside)):
        with Stage(robot, 64, 48, scene=scene) as stage:
            pictures.append(stage.picture(where).astype(int))
            with_ghost = stage.picture(where, where - np.eye(len(where))[1])
    assert np.abs(pictures[1] - pictures[0]).max() <= 1
    box = (np.abs(pictures[2] - pictures[0]) > 20).any(axis=2)
    assert box.sum() > 30
    assert np.array_equal(with_ghost[box], pictures[2][box]) and (with_ghost != pictures[2]).any()
