"""Ends in the default pose: what meets where, which feet stay, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from core.rotations import projected_gravity, quat_from_axis_angle, quat_mul, quat_rotate
from motion.clip import Clip
from motion.feet import sole_points_w
from motion.finish import with_default_ends
from motion.library import open_motion
from motion.report.trace import trace_clip
from tests.motion.checks import sunk_m, within_limits
from tests.robot.toy import load_toy
from tests.shared_data import SHARED, needs_shared_data

ARRAYS = ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact")


def cut(clip: Clip, first: int, end: int) -> Clip:
    return replace(clip, **{name: getattr(clip, name)[first:end] for name in ARRAYS})


def soles(clip: Clip, robot) -> np.ndarray:
    bodies = robot.kinematics.forward(clip.root_pos_w, clip.root_quat_wxyz, clip.joint_pos_rad)
    return sole_points_w(robot, bodies.pos_w, bodies.quat_wxyz)


@pytest.fixture(scope="module")
def kick(high_kick) -> Clip:
    """Frames of the kick on the right leg, the left one in the air at either end."""
    return cut(high_kick, 150, 260)


def test_it_begins_and_ends_in_the_default_pose(robot, kick):
    clip = with_default_ends(kick, robot, 1.0)
    assert clip.num_frames == kick.num_frames + 100
    for frame in (0, -1):
        tilt = projected_gravity(clip.root_quat_wxyz[frame])[:2]
        np.testing.assert_allclose(tilt, 0.0, atol=1e-9 if frame == 0 else 2e-3)
    np.testing.assert_allclose(clip.joint_pos_rad[0], robot.default_pos_rad, atol=1e-12)
    np.testing.assert_allclose(clip.joint_pos_rad[-1], robot.default_pos_rad, atol=1e-12)
    assert soles(clip, robot)[[0, -1], :, :, 2] == pytest.approx(0.0, abs=1e-6)


def test_the_clip_itself_is_untouched(robot, kick):
    clip = with_default_ends(kick, robot, 1.0)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(clip, name)[50:-50], getattr(kick, name))


def test_the_foot_that_stands_does_not_slide(robot, kick):
    assert kick.contact[0].tolist() == kick.contact[-1].tolist() == [0.0, 1.0]
    clip = with_default_ends(kick, robot, 1.0)
    for part in (slice(0, 51), slice(-51, None)):
        points = soles(clip, robot)[part, 1]
        assert np.abs(points - points[0])[..., :2].max() < 1e-6
        assert np.abs(points[..., 2]).max() < 5e-4  # where the other foot comes down, it may lift the robot a little
    assert clip.contact[:50].tolist() == clip.contact[-50:].tolist() == [[0.5, 1.0]] * 50
    report = trace_clip(clip, robot)
    assert report.max_slide_m < 1e-3 and sunk_m(report) < 1e-3
    assert within_limits(report)


def test_it_moves_without_jerks(robot, kick):
    """At either seam the joints' velocity goes on; it is 0 at the outer ends."""
    clip = with_default_ends(kick, robot, 1.0)
    velocity = np.diff(clip.joint_pos_rad, axis=0) * clip.fps
    assert np.abs(velocity[[0, -1]]).max() < 0.01
    inside = np.abs(np.diff(velocity, axis=0)[60:-60]).max()
    assert np.abs(np.diff(velocity, axis=0)).max() < 3.0 * inside
    root = np.diff(clip.root_pos_w, axis=0) * clip.fps
    assert np.abs(np.diff(root, axis=0)).max() < 0.05


def test_feet_elsewhere_share_the_way(robot, standing_clip):
    """A stance wider than the default one: both feet slide inwards alike, so neither is known to stand."""
    joints = standing_clip().joint_pos_rad.copy()
    for joint, spread_rad in (("hip_roll", 0.15), ("ankle_roll", -0.15)):
        joints[:, robot.joint_names.index(f"left_{joint}_joint")] += spread_rad
        joints[:, robot.joint_names.index(f"right_{joint}_joint")] -= spread_rad
    wide = standing_clip(joint_pos_rad=joints)
    lift = soles(wide, robot)[0, ..., 2].min()
    clip = with_default_ends(replace(wide, root_pos_w=wide.root_pos_w - [0.0, 0.0, lift]), robot, 0.5)
    assert clip.contact[:15].tolist() == [[0.5, 0.5]] * 15
    way = (soles(clip, robot)[0] - soles(clip, robot)[15]).mean(axis=1)[:, 1]
    assert way[0] == pytest.approx(-way[1], abs=1e-3) and way[0] < -0.05
    assert np.abs(soles(clip, robot)[:15, ..., 2].min(axis=(1, 2))).max() < 1e-6


def test_a_stance_like_the_default_one_stays(robot, standing_clip):
    """Only the arms differ: both feet are known to stand."""
    joints = standing_clip().joint_pos_rad.copy()
    joints[:, robot.joint_names.index("left_elbow_joint")] += 0.5
    clip = standing_clip(joint_pos_rad=joints)
    lift = soles(clip, robot)[0, :, :, 2].min()
    clip = with_default_ends(replace(clip, root_pos_w=clip.root_pos_w - [0.0, 0.0, lift]), robot, 1.0)
    np.testing.assert_array_equal(clip.contact, 1.0)
    assert trace_clip(clip, robot).max_slide_m < 1e-6


def test_the_heading_is_that_of_the_clip(robot, kick):
    """The same clip turned by 100 degrees about the vertical and moved gets the same ends, turned and moved."""
    quat = quat_from_axis_angle(np.array([0.0, 0.0, 1.0]), np.deg2rad(100.0))
    move = np.array([3.0, -2.0, 0.0])

    def elsewhere(clip: Clip) -> Clip:
        turn = np.tile(quat, (clip.num_frames, 1))
        pos = quat_rotate(turn, clip.root_pos_w) + move
        return replace(clip, root_pos_w=pos, root_quat_wxyz=quat_mul(turn, clip.root_quat_wxyz))

    got, expected = with_default_ends(elsewhere(kick), robot, 1.0), elsewhere(with_default_ends(kick, robot, 1.0))
    np.testing.assert_allclose(got.root_pos_w, expected.root_pos_w, atol=1e-9)
    same = np.abs((got.root_quat_wxyz * expected.root_quat_wxyz).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-9)


def test_a_clip_that_begins_in_the_default_pose_gets_no_blend(robot):
    clip = open_motion("taichi", robot)
    assert with_default_ends(clip, robot, 1.0).sha256 == clip.sha256


def test_in_the_air_it_is_a_plain_blend(robot, standing_clip):
    joints = standing_clip().joint_pos_rad + 0.05
    clip = standing_clip(joint_pos_rad=joints, contact=np.zeros((31, 2)), root_pos_w=np.tile([0, 0, 1.2], (31, 1)))
    ended = with_default_ends(clip, robot, 1.0)
    assert ended.contact[:30].tolist() == [[0.5, 0.5]] * 30
    height = soles(ended, robot)[..., 2].min(axis=(1, 2))
    assert height[0] == pytest.approx(0.0, abs=1e-6) and (np.diff(height[:31]) > 0.0).all()


def test_a_joint_near_its_limit_stays_inside(robot, standing_clip):
    """It leaves its upper limit downwards at 5 rad/s: coming from below it may not swing beyond."""
    joint = robot.joint_names.index("left_knee_joint")
    joints = standing_clip().joint_pos_rad.copy()
    joints[:, joint] = robot.pos_upper_rad[joint] - 5.0 * np.arange(31) / 30.0 * (np.arange(31) < 5)
    ended = with_default_ends(standing_clip(joint_pos_rad=joints), robot, 1.0)
    assert ended.joint_pos_rad[:, joint].max() <= robot.pos_upper_rad[joint] + 1e-12


@pytest.mark.parametrize(
    ("seconds", "message"),
    [
        (0.0, "bad length of a blend, got 0 s"),
        (-1.0, "bad length"),
        (np.nan, "bad length"),
        (1e9, "at most 60 s"),
        (0.04, "blend too short for .*, got 0.04 s, expected at least 0.15 s"),
    ],
)
def test_bad_lengths_are_refused(robot, kick, seconds, message):
    with pytest.raises(InputError, match=message):
        with_default_ends(kick, robot, seconds)


def test_other_joints_are_refused(robot, kick):
    with pytest.raises(InputError, match="joints"):
        with_default_ends(kick, load_toy(), 1.0)


def test_the_default_length_comes_from_the_settings(robot, kick):
    assert with_default_ends(kick, robot).num_frames == kick.num_frames + 100


@needs_shared_data
def test_an_imported_clip_from_its_middle(robot):
    dance = cut(open_motion(SHARED / "pbhc" / "Charleston_dance.pkl", robot), 100, 400)
    clip = with_default_ends(dance, robot, 1.0)
    assert clip.num_frames == 360
    report, before = trace_clip(clip, robot), trace_clip(dance, robot)
    assert report.max_slide_m == before.max_slide_m and sunk_m(report) == sunk_m(before)
    assert within_limits(report)
