"""A recording goes all the way: what comes out is what went in, on the robot."""

from pathlib import Path

import numpy as np
import pytest

from core.errors import InputError
from motion.clip import save_clip
from motion.pipeline import ProcessRequest, process
from motion.reference import joint_columns
from motion.report.record import TRACKABLE, figures
from tests.shared_data import SHARED, needs_shared_data
from world.scene import Scene

STEPS = ("read", "filter", "contact", "correct", "retarget", "finish", "forces")


@pytest.fixture(scope="module")
def t_pose(tmp_path_factory) -> Path:
    """An AMASS file of a person who stands still with the arms to the sides, facing -y as the body model does."""
    path = tmp_path_factory.mktemp("amass") / "t_pose.npz"
    poses = np.zeros((40, 156))
    poses[:, 0] = np.pi / 2.0  # from y up, as the body model has it, to z up
    trans = np.tile([3.0, -2.0, 1.2], (40, 1))
    np.savez(path, poses=poses, trans=trans, betas=np.zeros(16), gender="neutral", mocap_framerate=30.0)
    return path


def test_a_person_with_arms_to_the_sides_becomes_a_robot_with_arms_to_the_sides(t_pose, robot):
    said = []
    record = process(ProcessRequest(t_pose, "t_pose"), said.append)
    assert [line.split(":")[0] for line in said if not line.startswith(" ")] == list(STEPS)
    assert record.verdict == TRACKABLE, record.reasons
    middle = record.clip.num_frames // 2
    joints = record.clip.joint_pos_rad[middle, joint_columns(record.clip, robot)]
    state = robot.kinematics.forward(record.clip.root_pos_w[middle], record.clip.root_quat_wxyz[middle], joints)
    at = dict(zip(robot.tracked_names, state.pos_w, strict=True))
    arm = at["left_hand_link"] - at["left_shoulder_roll_link"]
    assert arm[0] > 0.9 * np.linalg.norm(arm)  # who faces -y has the left arm along +x
    assert abs(at["left_hand_link"][2] - at["right_hand_link"][2]) < 0.02
    assert (record.clip.contact[middle] == 1.0).all()
    told = figures(record.trace, record.clip_verdict, record.residual)
    assert told["penetration_mm"] < 1.0 and told["floating_mm"] < 5.0 and told["sliding_mm"] < 1.0


def test_a_mirrored_person_raises_the_other_arm(t_pose, robot):
    arrays = dict(np.load(t_pose))
    arrays["poses"][:, 3 * 16 + 2] = -1.2  # SMPL's left shoulder, about the axis to the front: the arm goes down
    np.savez(t_pose.with_name("one_arm.npz"), **arrays)
    asked = ProcessRequest(t_pose.with_name("one_arm.npz"), "one_arm")
    plain, mirrored = (process(request, lambda text: None).clip for request in (asked, _with(asked, mirror=True)))
    names = [f"{side}_shoulder_roll_joint" for side in ("left", "right")]
    left, right = (plain.joint_pos_rad[35, plain.joint_names.index(name)] for name in names)
    assert left < 0.8 < 1.2 < -right  # rolls turn outward: left ones with +, right ones with -
    there = [mirrored.joint_pos_rad[35, mirrored.joint_names.index(name)] for name in names]
    assert there == pytest.approx([-right, -left], abs=1e-6)


def test_ends_are_the_default_pose_and_faster_recordings_are_resampled(standing_clip, robot, tmp_path):
    joints = np.tile(robot.default_pos_rad, (121, 1))
    joints[:, robot.joint_names.index("left_elbow_joint")] += 0.4
    save_clip(standing_clip(121, fps=120.0, joint_pos_rad=joints), tmp_path / "bent.npz")
    record = process(ProcessRequest(tmp_path / "bent.npz", "bent"), lambda text: None)
    clip = record.clip
    assert (record.before.fps, clip.fps, clip.created_by) == (120.0, 60.0, "kata motion/process")
    assert clip.duration_s == pytest.approx(3.0)  # a second, and one more on either side
    away = np.abs(clip.joint_pos_rad[:, joint_columns(clip, robot)] - robot.default_pos_rad).max(axis=1)
    assert away[0] == pytest.approx(0.0, abs=1e-9) and away[-1] < 1e-3
    assert away[90] == pytest.approx(0.4, abs=1e-3)


def test_a_part_of_the_recording(standing_clip, tmp_path):
    save_clip(standing_clip(91), tmp_path / "long.npz")
    record = process(ProcessRequest(tmp_path / "long.npz", "long", start_s=1.0, end_s=2.0), lambda text: None)
    assert record.before.num_frames == 31
    assert record.options == {"start_s": 1.0, "end_s": 2.0}
    with pytest.raises(InputError, match="times outside the motion"):
        process(ProcessRequest(tmp_path / "long.npz", "long", end_s=3.5), lambda text: None)


def test_a_clip_with_a_scene_is_refused(standing_clip, tmp_path):
    save_clip(standing_clip(scene=Scene(-0.1)), tmp_path / "low.npz")
    with pytest.raises(InputError, match=r"low\.npz: has a scene, expected a motion on flat ground at height 0"):
        process(ProcessRequest(tmp_path / "low.npz", "low"), lambda text: None)


def test_a_rejected_motion_goes_on_as_far_as_it_can(standing_clip, tmp_path):
    high = np.tile([0.0, 0.0, 1.8], (61, 1))
    save_clip(standing_clip(61, root_pos_w=high, contact=np.zeros((61, 2))), tmp_path / "high.npz")
    record = process(ProcessRequest(tmp_path / "high.npz", "high"), lambda text: None)
    assert not record.input_verdict.stable and record.clip is not None
    assert any("floating" in reason for reason in record.reasons)
    too_short = process(ProcessRequest(tmp_path / "high.npz", "high", end_s=1.0, loop=True), lambda text: None)
    assert too_short.clip is None and "too short to loop" in too_short.failure


@needs_shared_data
def test_the_recorded_person_stands_on_the_ground_and_slides_little():
    record = process(ProcessRequest(SHARED / "bvh" / "mocapbank.bvh", "mocapbank"), lambda text: None)
    told = figures(record.trace, record.clip_verdict, record.residual)
    assert told["penetration_mm"] <= 10.0 and told["sliding_mm"] <= 20.0
    assert told["limit_violations"] == told["speed_violations"] == 0


@needs_shared_data
@pytest.mark.parametrize("name", ["M_Move10", "M_Move19"])
def test_a_robots_recording_stands_on_the_ground(name):
    said = []
    record = process(ProcessRequest(SHARED / "g1moves" / f"{name}.csv", name, fps=60.0), said.append)
    told = figures(record.trace, record.clip_verdict, record.residual)
    assert record.verdict == TRACKABLE and record.reasons == ()
    assert told["penetration_mm"] <= 10.0 and told["sliding_mm"] <= 20.0 and told["floating_mm"] <= 20.0
    assert told["limit_violations"] == told["speed_violations"] == 0
    assert record.change is not None and record.change.root_m < 0.1
    assert any("where a foot travels" in line for line in said)
    assert f"the root by up to {1e3 * record.change.root_m:.0f} mm" in record.notes[-1]


def _with(request: ProcessRequest, **changes) -> ProcessRequest:
    return ProcessRequest(**(vars(request) | changes))
