"""report.json tells of the written clip, in the units that it says."""

import json

import numpy as np
import pytest

from motion.report.record import document, figures, json_text
from motion.report.trace import trace_clip
from motion.report.warnings import WarningSettings, warnings_of
from motion.retarget.clean import Change
from tests.motion.report.verdicts import verdict_of
from world.scene import Box, Scene

KEYS = {
    "verdict", "reasons", "penetration_mm", "floating_mm", "sliding_mm", "com_cop_mm", "airborne_frames",
    "limit_violations", "speed_violations", "self_collisions", "residual_torque_nm", "residual_force_n",
    "residual_at_s", "largest_change", "failing_frames", "rules", "notes", "input", "clip",
    "robot", "options", "settings_sha256", "created_by",
}  # fmt: skip


def raised(standing_clip, height_m, **changes):
    """Standing with the root so high."""
    count = changes.pop("num_frames", 31)
    return standing_clip(count, root_pos_w=np.tile([0.0, 0.0, height_m], (count, 1)), **changes)


def test_one_centimetre_up_or_down_is_ten_millimetres(standing_clip, record_of, robot):
    high = document(record_of(raised(standing_clip, 0.83)))
    higher = document(record_of(raised(standing_clip, 0.84)))
    low = document(record_of(raised(standing_clip, 0.70)))
    lower = document(record_of(raised(standing_clip, 0.69)))
    assert higher["floating_mm"] - high["floating_mm"] == pytest.approx(10.0, abs=2e-3)
    assert lower["penetration_mm"] - low["penetration_mm"] == pytest.approx(10.0, abs=2e-3)
    assert high["penetration_mm"] == low["floating_mm"] == 0.0
    assert high["floating_mm"] + low["penetration_mm"] == pytest.approx(130.0, abs=2e-3)  # 0.83 - 0.70 m


def test_heights_are_those_above_the_scene(standing_clip, robot):
    """A centimetre into the ground, as into a floor or a box half a metre higher."""
    low = trace_clip(raised(standing_clip, 0.75), robot)
    assert low.penetration_m.max() > 0.01
    for scene in (Scene(0.5), Scene(0.0, (Box((0.0, 0.0, 0.25), (2.0, 2.0, 0.25)),))):
        higher = trace_clip(raised(standing_clip, 1.25, scene=scene), robot)
        assert higher.penetration_m == pytest.approx(low.penetration_m, abs=1e-4)
        assert higher.lowest_sole_m == pytest.approx(low.lowest_sole_m, abs=1e-9)


def test_sliding_is_the_worst_contact_of_either_foot(standing_clip, record_of):
    x = np.zeros(31)
    x[5:] = 0.007  # in the first contact of both feet
    x[20:] += 0.011  # in the second of the right one; the left is in the air
    contact = np.ones((31, 2))
    contact[12:16] = 0.0
    contact[16:, 0] = 0.0
    clip = standing_clip(root_pos_w=np.stack([x, 0 * x, np.full(31, 0.79)], axis=1), contact=contact)
    assert document(record_of(clip))["sliding_mm"] == pytest.approx(11.0, abs=1e-3)
    ways = [
        (slide.foot, slide.first, slide.end, round(1e3 * slide.way_m, 3))
        for slide in trace_clip(clip, record_of(clip).robot).slides
    ]
    assert ways == [(0, 0, 12, 7.0), (1, 0, 12, 7.0), (1, 16, 31, 11.0)]


def test_violations_count_frames_times_joints(standing_clip, record_of, robot):
    joints = np.tile(robot.default_pos_rad, (31, 1))
    joints[10:13, [0, 5]] = robot.pos_upper_rad[[0, 5]] + 0.05
    told = document(record_of(standing_clip(joint_pos_rad=joints)))
    assert told["limit_violations"] == 6
    leaps = np.abs(np.diff(joints, axis=0)) * 30.0 > robot.vel_limit_rad_s
    assert told["speed_violations"] == leaps.sum() > 0


def test_in_the_air_there_is_no_distance_but_a_count_of_frames(standing_clip, record_of):
    distance_m = np.linspace(0.01, 0.04, 31)
    distance_m[20:] = np.inf
    told = document(record_of(standing_clip(), clip_verdict=verdict_of(31, distance_m=distance_m)))
    assert told["airborne_frames"] == 11 and told["com_cop_mm"] == pytest.approx(29.0)  # 10 + 19 mm
    told = document(record_of(standing_clip(), clip_verdict=verdict_of(31, distance_m=np.full(31, np.inf))))
    assert told["airborne_frames"] == 31 and told["com_cop_mm"] is None


def test_a_robot_that_hangs_in_the_air_lacks_all_of_its_weight(standing_clip, record_of):
    told = document(record_of(raised(standing_clip, 1.8, contact=np.zeros((31, 2)))))
    assert told["residual_force_n"] == pytest.approx(33.34114 * 9.81, abs=0.1)  # the mass in the robot's MJCF
    assert told["residual_at_s"] == 0.0


def test_the_document_has_every_key_and_is_plain_json(standing_clip, record_of):
    record = record_of(standing_clip(), input_verdict=verdict_of(31, (3, 4)))
    text = json_text(document(record))
    told = json.loads(text)
    assert told.keys() == KEYS == document(record).keys()
    assert text.count("\n") == len(KEYS) + 2
    assert told["verdict"] == "trackable" and told["reasons"] == []
    assert told["failing_frames"] == {"input": [3, 4], "clip": []}
    assert told["rules"]["input"] == {"rule": {"passed": True, "value": 2.0, "limit": 2.0}}
    assert told["input"] | {"fps": 30.0} == {
        "file": "walk.csv", "sha256": "ab" * 32, "fps": 30.0, "frames": 31, "duration_s": 1.0,
    }  # fmt: skip
    with pytest.raises(ValueError, match="JSON"):
        json_text({"a": float("nan")})


@pytest.mark.parametrize("whose", ["input", "clip"])
def test_one_verdict_against_it_is_enough(standing_clip, record_of, whose):
    record = record_of(standing_clip(), **{f"{whose}_verdict": verdict_of(31, (1,), "floating")})
    assert document(record)["verdict"] == "not trackable"
    assert document(record)["reasons"] == [f"{whose}: floating"]


def test_without_a_clip_there_are_no_figures(standing_clip, record_of):
    nothing = {"after": None, "clip": None, "clip_verdict": None}
    record = record_of(
        standing_clip(), **nothing, input_verdict=verdict_of(31, (1,), "floating"), failure="joint limits"
    )
    told = document(record)
    assert told.keys() == KEYS
    assert told["reasons"] == ["input: floating", "no clip: joint limits"]
    assert told["failing_frames"] == {"input": [1], "clip": None} and told["clip"] is None
    assert all(told[key] is None for key in figures(None, None, None))
    json_text(told)


def test_the_largest_change_of_a_robots_motion(standing_clip, record_of):
    change = Change(root_m=0.0123, root_rad=0.05, joint_rad=0.2, joint="left_knee_joint")
    assert document(record_of(standing_clip(), change=change))["largest_change"] == {
        "root_mm": 12.3, "root_rad": 0.05, "joint_rad": 0.2, "joint": "left_knee_joint",
    }  # fmt: skip
    assert document(record_of(standing_clip()))["largest_change"] is None


def test_a_trackable_clip_that_slides_is_told_with_a_warning(standing_clip, record_of):
    way = np.stack([np.linspace(0.0, 0.021, 31), np.zeros(31), np.full(31, 0.79)], axis=1)
    told = document(record_of(standing_clip(root_pos_w=way)))
    assert told["verdict"] == "trackable"
    assert told["reasons"] == ["clip: warning: a standing foot slides 21.0 mm (at most 20)"]


def test_every_figure_beyond_its_limit_warns():
    settings = WarningSettings(max_slide_m=0.02, max_penetration_m=0.01, max_float_m=0.03)
    lengths = ("sliding_mm", "penetration_mm", "floating_mm")
    fine = dict(zip(lengths, (20.0, 10.0, 30.0), strict=True)) | {"limit_violations": 0, "speed_violations": 0}
    assert warnings_of(fine, settings) == warnings_of(figures(None, None, None), settings) == ()
    for key, value in fine.items():
        (warning,) = warnings_of(fine | {key: value + 1}, settings)
        assert warning.startswith("warning: ") and f" {value + 1:.0f}" in warning
