"""Stick figures, plots and videos show the motion."""

import io

import av
import matplotlib.image
import numpy as np
import pytest

from motion.report import figures, film
from motion.report.skeletons import before_and_after, skeleton_of
from motion.report.trace import trace_clip


def pixels(png: bytes) -> np.ndarray:
    return matplotlib.image.imread(io.BytesIO(png))[..., :3]


@pytest.fixture
def waving_clip(standing_clip, robot):
    joints = np.tile(robot.default_pos_rad, (31, 1))
    joints += 0.2 * np.sin(np.linspace(0.0, 6.0, 31))[:, None] * np.linspace(-1.0, 1.0, robot.num_joints)
    return standing_clip(joint_pos_rad=joints)


def test_bones_of_a_robot_keep_their_length(waving_clip, robot):
    skeleton = skeleton_of(waving_clip, robot)
    assert skeleton.pos_w.shape == (31, len(robot.tracked_names), 3)
    assert [i for i, above in enumerate(skeleton.parents) if above < 0] == [0]
    below = np.arange(1, len(skeleton.parents))
    length = np.linalg.norm(skeleton.pos_w[:, below] - skeleton.pos_w[:, list(skeleton.parents)[1:]], axis=-1)
    assert np.ptp(length, axis=0).max() < 1e-9


def test_both_rows_are_drawn(waving_clip, robot):
    skeleton = skeleton_of(waving_clip, robot)
    one, two = (pixels(before_and_after([("a", skeleton)] * rows)) for rows in (1, 2))
    assert two.shape[0] == 2 * one.shape[0]
    upper, lower = np.split(two, 2)
    assert (upper < 0.9).any() and (lower < 0.9).any()


def test_shaded_frames_are_those_that_fail(waving_clip):
    calm = figures.Balance("a", 30.0, np.full(31, 0.05), np.array([], dtype=int))
    failing = figures.Balance("a", 30.0, np.full(31, 0.05), np.arange(10, 20))
    red = np.array([0xF3, 0xB8, 0xB2]) / 255.0

    def share(balance):
        return (np.abs(pixels(figures.balance_over_time([balance])) - red) < 0.01).all(axis=-1).mean()

    assert share(calm) == 0.0
    assert 0.15 < share(failing) < 0.35  # a third of the time axis, which is most of the picture


def test_violations_are_marked_in_the_plots(toy_clip, toy):
    hip = toy.joint_names.index("left_hip")
    beyond = toy_clip().joint_pos_rad.copy()
    beyond[10:20, hip] = toy.pos_upper_rad[hip] + 0.3
    calm, wild = (trace_clip(clip, toy) for clip in (toy_clip(), toy_clip(joint_pos_rad=beyond)))
    assert wild.position_violations.sum() == 10 and wild.speed_violations.sum() == 2

    def red(png):  # limits are dashed in the same colour
        return (np.abs(pixels(png) - np.array([214, 39, 40]) / 255.0) < 0.02).all(axis=-1).sum()

    for plot, dots in ((figures.joint_angles, 10), (figures.joint_speeds, 2)):
        assert red(plot(wild, toy)) >= red(plot(calm, toy)) + 2 * dots


def test_the_cursor_stands_where_the_time_is():
    plot = np.full((film.SIZE_PX, film.SIZE_PX, 3), 255, dtype=np.uint8)
    for share in (0.0, 0.5, 1.0):
        columns = np.flatnonzero((film.with_cursor(plot, share) != 255).any(axis=(0, 2)))
        expected = film.SIZE_PX * (0.09 + share * 0.89)
        assert np.abs(columns - expected).max() <= 1.5
    assert (plot == 255).all()


def test_the_video_lasts_as_long_as_the_clip(standing_clip, robot, tmp_path, monkeypatch):
    monkeypatch.setenv("KATA_RENDERER", "software")
    monkeypatch.setattr("motion.report.film.SIZE_PX", 160)
    clip = standing_clip(41, fps=200.0)  # 0.2 s: 7 pictures at 30 per second
    heard = []
    film.film(clip, robot, tmp_path / "a.mp4", lambda number, total: heard.append((number, total)))
    with av.open(str(tmp_path / "a.mp4")) as video:
        pictures = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
        assert video.streams.video[0].average_rate == 30
    assert len(pictures) == 7 and heard == [(i, 7) for i in range(1, 8)]
    assert pictures[0].shape == (film.SIZE_PX, 2 * film.SIZE_PX, 3)
    assert (pictures[0][:, film.SIZE_PX :] != pictures[-1][:, film.SIZE_PX :]).any()  # the cursor has moved
