"""Verdicts on good clips and on the same clips broken on purpose, human's and robot's."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate
from motion.contact import contact_of
from motion.filter import judge
from motion.human.correct import correct_height
from motion.library import bundled_names, open_motion
from motion.read import read_motion
from motion.resample import resample
from tests.motion.figure import SOLE_MIDDLE_M, moved, standing_figure, turned
from tests.shared_data import SHARED, needs_shared_data
from world.scene import Box, Scene

IMPORTED = (
    *("pbhc/Charleston_dance.pkl", "pbhc/Horse-stance_pose.pkl", "pbhc/Roundhouse_kick.pkl"),
    *("g1moves/M_Move19.csv", "g1moves/M_Move3.csv", "g1moves/M_Move10.csv", "g1moves/J_Dance0_StepTouch.csv"),
)
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0)}


def tilted(clip, degrees: float, axis: str):
    """The whole world turned about the origin."""
    quat = quat_from_axis_angle(np.array(AXES[axis]), np.deg2rad(np.full(clip.num_frames, degrees)))
    pos = quat_rotate(quat, clip.root_pos_w)
    return replace(clip, root_pos_w=pos, root_quat_wxyz=quat_mul(quat, clip.root_quat_wxyz))


def shifted(clip, offset_m: tuple[float, float, float], from_frame: int = 0):
    pos = clip.root_pos_w.copy()
    pos[from_frame:] += offset_m
    return replace(clip, root_pos_w=pos)


def broken(clip, robot) -> dict[str, set[str]]:
    """Rules that each way of breaking the clip was caught by."""
    middle = clip.num_frames // 2
    ways = {
        "floating": shifted(clip, (0.0, 0.0, 0.3)),
        "sunk": shifted(clip, (0.0, 0.0, -0.3)),
        "teleporting": shifted(clip, (0.3, 0.0, 0.0), middle),
        **{f"tilted {d} {a}": tilted(clip, d, a) for d in (-20.0, 20.0) for a in AXES},
    }
    verdicts = {name: judge((way, robot)) for name, way in ways.items()}
    return {name: {f.rule for f in verdict.findings if not f.passed} for name, verdict in verdicts.items()}


@pytest.mark.parametrize("name", bundled_names())
def test_bundled_clips_pass_and_broken_ones_do_not(robot, name):
    clip = open_motion(name, robot)
    verdict = judge((clip, robot))
    assert verdict.stable and verdict.reasons == () and len(verdict.failing_frames) == 0
    caught = broken(clip, robot)
    assert {way for way, rules in caught.items() if not rules} == set()
    assert {"flight", "balance"} <= caught["floating"]
    assert caught["sunk"] == {"sinking"} and caught["teleporting"] == {"jump"}
    assert all({"balance", "tilt"} <= rules for way, rules in caught.items() if way.startswith("tilted"))


@needs_shared_data
@pytest.mark.parametrize("name", IMPORTED)
def test_imported_clips_pass_and_broken_ones_do_not(robot, name):
    clip = open_motion(SHARED / name, robot)
    assert judge((clip, robot)).reasons == ()
    assert {way for way, rules in broken(clip, robot).items() if not rules} == set()
    played_too_fast = judge((replace(clip, fps=3.0 * clip.fps), robot))
    assert any("too violent" in reason for reason in played_too_fast.reasons)


def test_a_dance_played_too_fast_is_rejected_and_a_slow_one_is_not(robot, lively_dance):
    """High kicks at three times their speed need more than the ground can give; tai chi is merely quick then."""
    lively, slow = (judge((replace(c, fps=3.0 * c.fps), robot)) for c in (lively_dance, open_motion("taichi", robot)))
    assert slow.stable
    assert [finding.rule for finding in lively.findings if not finding.passed] == ["force"]


@pytest.mark.parametrize("fps", [25.0, 30.0, 60.0, 120.0])
def test_the_verdict_does_not_depend_on_the_frame_rate(robot, lively_dance, fps):
    clip = resample(lively_dance, fps)
    assert judge((clip, robot)).stable
    assert not judge((replace(clip, fps=3.0 * fps), robot)).stable
    assert not judge((shifted(clip, (0.3, 0.0, 0.0), clip.num_frames // 2), robot)).stable


def test_a_standing_human_passes():
    verdict = judge(standing_figure())
    assert verdict.stable
    np.testing.assert_allclose(verdict.distance_m, 0.0, atol=0.01)  # hips above the middle of the soles


@pytest.mark.parametrize(("lean_m", "stable"), [(0.0, True), (0.1, True), (0.16, False)])
def test_a_human_that_leans_beyond_the_toes_fails(lean_m, stable):
    """The toes are 0.1225 m before the middle of the soles."""
    verdict = judge(standing_figure(forward_m=SOLE_MIDDLE_M + lean_m))
    assert verdict.stable is stable
    if not stable:
        assert len(verdict.failing_frames) == 61 and verdict.reasons[0].startswith("out of balance: in the first frame")
    assert verdict.distance_m[0] == pytest.approx(lean_m, abs=0.02)


@needs_shared_data
def test_a_recorded_human_who_kneels_passes(robot):
    """5 s on one knee: the centre of mass is behind both soles' middle, above foot, toes and knee."""
    m = read_motion(SHARED / "bvh" / "mocapbank.bvh", fps=None, robot=robot, skeleton=None, body_models=None)
    assert judge(m).reasons == ()
    corrected = correct_height(m, contact_of(m))
    assert judge(corrected).reasons == ()
    standing = contact_of(m).max(axis=1) > 0.5
    assert np.abs(corrected.sole_w[standing][..., 2].min(axis=(1, 2))).max() < 0.005
    assert not judge(moved(m, np.array([0.0, 0.0, 0.3]))).stable
    assert not judge(turned(m, quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.deg2rad(20.0)))).stable


def test_broken_humans_fail():
    m = standing_figure(121)
    leap = np.where(np.arange(121) < 60, 0.0, 0.3)[:, None] * np.array([1.0, 0.0, 0.0])
    ways = {
        "floating": (moved(m, np.array([0.0, 0.0, 0.3])), "flight"),
        "tilted": (turned(m, quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.deg2rad(20.0))), "tilt"),
        "teleporting": (moved(m, leap), "jump"),
        "in centimetres": (moved(m, leap * 300.0), "speed"),
    }
    for name, (way, rule) in ways.items():
        verdict = judge(way)
        assert rule in {finding.rule for finding in verdict.findings if not finding.passed}, name
        assert not verdict.stable and len(verdict.failing_frames)


def test_a_human_that_sways_fails_when_played_too_fast():
    sway = 0.04 * np.sin(2.0 * np.pi * 0.8 * np.arange(121) / 30.0)[:, None] * np.array([0.0, 1.0, 0.0])
    m = standing_figure(121)
    swaying = moved(m, sway)
    swaying = replace(swaying, sole_w=m.sole_w)
    assert judge(swaying).stable
    assert not judge(replace(swaying, fps=120.0)).stable


def test_two_frames_are_judged(robot, standing_clip):
    assert judge(standing_figure(2)).stable
    assert judge((standing_clip(2), robot)).distance_m.shape == (2,)


def test_other_joints_are_an_error(robot, standing_clip):
    clip = standing_clip()
    with pytest.raises(InputError, match="joints"):
        judge((replace(clip, joint_names=(*clip.joint_names[:-1], "tail_joint")), robot))


@pytest.mark.parametrize("scene", [Scene(0.5), Scene(0.0, (Box((0.0, 0.0, 0.25), (9.0, 9.0, 0.25)),))])
def test_half_a_metre_higher_is_no_flight_where_the_scene_is(robot, scene):
    """Every figure and the contacts of Eq. 2 are those of the clip on the ground."""
    clip = open_motion("side_kick", robot)
    higher = replace(shifted(clip, (0.0, 0.0, 0.5)), scene=scene)
    found, expected = judge((higher, robot)), judge((clip, robot))
    assert found.distance_m == pytest.approx(expected.distance_m, abs=1e-9)
    assert [f.value for f in found.findings] == pytest.approx([f.value for f in expected.findings], abs=1e-6)
    assert np.array_equal(contact_of((higher, robot)), contact_of((clip, robot)))
