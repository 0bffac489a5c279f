"""Loops: the seam, the drift, the feet."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from core.rotations import quat_from_axis_angle, yaw_of
from motion.finish import loop_clip
from motion.report.trace import trace_clip
from tests.motion.checks import sunk_m

FPS, SECONDS = 30.0, 0.5


@pytest.fixture(scope="module")
def waving(robot):
    """Builds 5 s in which the arms swing at 1 Hz while the root drifts and turns."""

    def build(standing_clip, drift_m: float = 0.2, turn_rad: float = 0.3, contact: float = 0.0, stop_s: float = 5.3):
        t = np.arange(round(stop_s * FPS) + 1) / FPS
        joints = np.tile(robot.default_pos_rad, (len(t), 1))
        for side in ("left", "right"):
            joints[:, robot.joint_names.index(f"{side}_shoulder_pitch_joint")] += 0.4 * np.sin(2.0 * np.pi * t)
        pos = np.stack([drift_m * t / t[-1], -0.5 * drift_m * t / t[-1], np.full_like(t, 0.8)], axis=1)
        return standing_clip(
            len(t),
            FPS,
            joint_pos_rad=joints,
            root_pos_w=pos,
            root_quat_wxyz=quat_from_axis_angle(np.tile([0.0, 0.0, 1.0], (len(t), 1)), turn_rad * t / t[-1]),
            contact=np.full((len(t), 2), contact),
        )

    return build


def test_the_last_frame_is_the_first(robot, waving, standing_clip):
    clip = loop_clip(waving(standing_clip), robot, SECONDS)
    for name in ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact"):
        np.testing.assert_allclose(getattr(clip, name)[-1], getattr(clip, name)[0], atol=1e-9)


def test_it_is_shorter_by_the_blend(robot, waving, standing_clip):
    clip = waving(standing_clip)
    assert loop_clip(clip, robot, SECONDS).num_frames == clip.num_frames - 15


def test_the_motion_goes_on_through_the_seam(robot, waving, standing_clip):
    """Velocities on either side of the seam differ no more than inside; the arms' phases differ by 0.3 of a swing."""
    clip = loop_clip(waving(standing_clip), robot, SECONDS)
    twice = np.concatenate([clip.joint_pos_rad, clip.joint_pos_rad[1:]])
    bend = np.abs(np.diff(twice, 2, axis=0)).max(axis=1) * FPS**2
    seam = clip.num_frames - 1
    assert bend[seam - 2 : seam + 1].max() < 1.2 * 0.4 * (2.0 * np.pi) ** 2
    root = np.concatenate([clip.root_pos_w, clip.root_pos_w[1:]])
    assert np.abs(np.diff(root, axis=0)).max() * FPS < 0.2


def test_drift_and_heading_are_taken_out(robot, waving, standing_clip):
    clip = loop_clip(waving(standing_clip, drift_m=0.4, turn_rad=0.5), robot, SECONDS)
    assert np.ptp(clip.root_pos_w, axis=0)[:2].max() < 0.05
    assert np.ptp(yaw_of(clip.root_quat_wxyz)) < 0.08


def test_the_height_follows_the_feet(robot, waving, standing_clip):
    clip = waving(standing_clip, contact=1.0)
    found = trace_clip(loop_clip(clip, robot, SECONDS), robot)
    assert sunk_m(found) == pytest.approx(sunk_m(trace_clip(clip, robot)), abs=1e-6)


def test_feet_that_stand_at_both_ends_do_not_slide(robot, high_kick):
    """The kick's standing leg, cut out of the clip in poses that differ: its foot stays in its place."""
    arrays = ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact")
    clip = replace(high_kick, **{name: getattr(high_kick, name)[150:260] for name in arrays})
    found = trace_clip(loop_clip(clip, robot, SECONDS), robot)
    assert found.max_slide_m < 2e-3 and sunk_m(found) < 2e-3


def test_contact_where_the_feet_differ_is_unknown(robot, waving, standing_clip):
    clip = waving(standing_clip, drift_m=0.0, turn_rad=0.0, contact=1.0)
    contact = clip.contact.copy()
    contact[:30, 0] = 0.0
    looped = loop_clip(replace(clip, contact=contact), robot, SECONDS)
    assert looped.contact[-16:-1].tolist() == [[0.5, 1.0]] * 15
    assert looped.contact[-1].tolist() == looped.contact[0].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("changes", "seconds", "message"),
    [
        ({"drift_m": 3.0}, 0.5, "the motion travels, it does not loop, got 3.*expected at most 0.5 m"),
        ({"turn_rad": 2.0}, 0.5, "the motion travels"),
        ({}, 2.0, "too short to loop, got 5.3 s, expected more than three blends of 2 s"),
        ({}, 0.0, "bad length of a blend"),
        ({}, 0.004, "blend too short for .*shoulder_pitch_joint"),
    ],
)
def test_what_does_not_loop_is_refused(robot, waving, standing_clip, changes, seconds, message):
    clip = waving(standing_clip, **changes)
    if seconds == 0.004:
        joints = clip.joint_pos_rad.copy()
        joints[:80] += 1.5 * (np.array(robot.joint_names) == "left_shoulder_pitch_joint")
        clip = replace(clip, joint_pos_rad=joints)
    with pytest.raises(InputError, match=message):
        loop_clip(clip, robot, seconds)
