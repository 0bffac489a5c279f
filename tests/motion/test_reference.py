"""The reference tables: indexing by tick, joints by name, bodies against MuJoCo itself."""

import dataclasses

import mujoco
import numpy as np
import pytest

from core.errors import InputError
from motion.library import open_motion
from motion.reference import build_reference
from tests.shared_data import SHARED, needs_shared_data


@pytest.mark.parametrize(
    ("num_frames", "fps", "ticks"),
    [(210, 30.0, 348), (51, 50.0, 50), (2, 50.0, 1), (2, 30.0, 1), (31, 30.0, 50), (1001, 50.0, 1000), (8, 25.0, 14)],
)
def test_ticks_are_whole_control_periods(standing_clip, robot, num_frames, fps, ticks):
    reference = build_reference(standing_clip(num_frames, fps), robot)
    assert reference.num_ticks == ticks
    assert {len(getattr(reference, f)) for f in ("joint_pos_rad", "body_pos_w", "contact", "phase")} == {ticks + 1}


def test_phase(standing_clip, robot):
    reference = build_reference(standing_clip(210, 30.0), robot)  # 6.9666... s
    assert reference.phase[0] == 0.0
    assert reference.phase[100] == pytest.approx(2.0 / (209.0 / 30.0))
    assert reference.phase[-1] == pytest.approx(348 * 0.02 / (209.0 / 30.0))
    whole = build_reference(standing_clip(51, 50.0), robot)
    assert whole.phase[-1] == pytest.approx(1.0) and whole.phase.max() <= 1.0


def test_row_k_is_the_clip_at_k_dt(standing_clip, robot):
    angle = np.tile(robot.default_pos_rad, (31, 1))
    angle[:, 3] = np.arange(31) / 30.0  # knee: 1 rad/s
    root = np.tile([0.0, 0.0, 0.8], (31, 1)) + np.arange(31)[:, None] / 30.0 * [2.0, 0.0, 0.0]
    reference = build_reference(standing_clip(joint_pos_rad=angle, root_pos_w=root), robot)
    np.testing.assert_allclose(reference.joint_pos_rad[:, 3], np.arange(51) * 0.02, atol=1e-12)
    np.testing.assert_allclose(reference.joint_vel_rad_s[:, 3], 1.0, atol=1e-12)
    np.testing.assert_allclose(reference.root_pos_w[:, 0], np.arange(51) * 0.04, atol=1e-12)
    np.testing.assert_allclose(reference.root_lin_vel_w, np.tile([2.0, 0.0, 0.0], (51, 1)), atol=1e-11)


def test_joints_are_matched_by_name(standing_clip, robot):
    clip = standing_clip(joint_pos_rad=np.tile(np.arange(23.0) / 50.0, (31, 1)))
    order = np.random.default_rng(3).permutation(23)
    shuffled = dataclasses.replace(
        clip, joint_names=tuple(robot.joint_names[i] for i in order), joint_pos_rad=clip.joint_pos_rad[:, order]
    )
    got, expected = build_reference(shuffled, robot), build_reference(clip, robot)
    np.testing.assert_array_equal(got.joint_pos_rad, expected.joint_pos_rad)
    np.testing.assert_array_equal(got.body_pos_w, expected.body_pos_w)


def test_other_joints_are_refused_by_name(standing_clip, robot):
    names = ("tail_joint", *robot.joint_names[1:])
    with pytest.raises(InputError, match=r"unknown tail_joint, missing left_hip_pitch_joint"):
        build_reference(dataclasses.replace(standing_clip(), joint_names=names), robot)


def test_length_and_period_have_limits(standing_clip, robot):
    with pytest.raises(InputError, match="bad length"):
        build_reference(standing_clip(2, 100.0), robot)
    with pytest.raises(InputError, match="bad length"):
        build_reference(standing_clip(3700, 1.0), robot)
    for dt in (0.0, -0.02, float("nan")):
        with pytest.raises(InputError, match="control period"):
            build_reference(standing_clip(), robot, dt)


def test_tables_are_read_only_float64(standing_clip, robot):
    reference = build_reference(standing_clip(), robot)
    for field in dataclasses.fields(reference):
        value = getattr(reference, field.name)
        if isinstance(value, np.ndarray):
            assert value.dtype == np.float64 and not value.flags.writeable, field.name


@needs_shared_data
def test_bodies_are_where_the_published_model_puts_them(robot):
    """MuJoCo on the maker's model, set to the clip's own frames (30 fps: every third is a multiple of 5 ticks)."""
    clip = open_motion(SHARED / "pbhc" / "Horse-stance_pose.pkl", robot)
    reference = build_reference(clip, robot)
    model = mujoco.MjModel.from_xml_path(str(SHARED / "robot" / "g1_23dof_reference.xml"))
    data = mujoco.MjData(model)
    frames = np.arange(0, 208, 3)
    ticks = frames // 3 * 5
    points = {
        "left_hand_link": ("left_elbow_link", [0.25, 0, 0]),
        "right_hand_link": ("right_elbow_link", [0.25, 0, 0]),
    }
    points["head_link"] = ("torso_link", [0, 0, 0.42])
    for frame, tick in zip(frames, ticks, strict=True):
        data.qpos[:3], data.qpos[3:7] = clip.root_pos_w[frame], clip.root_quat_wxyz[frame]
        for name, angle in zip(clip.joint_names, clip.joint_pos_rad[frame], strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        for index, name in enumerate(robot.tracked_names):
            parent, offset = points.get(name, (name, [0, 0, 0]))
            body = data.body(parent)
            expected = body.xpos + body.xmat.reshape(3, 3) @ np.array(offset)
            np.testing.assert_allclose(reference.body_pos_w[tick, index], expected, atol=2e-6, err_msg=name)
            assert abs(np.dot(reference.body_quat_wxyz[tick, index], body.xquat)) == pytest.approx(1.0, abs=1e-9)


@needs_shared_data
def test_body_velocities_are_what_mujoco_makes_of_root_and_joint_velocities(robot):
    reference = build_reference(open_motion(SHARED / "pbhc" / "Roundhouse_kick.pkl", robot), robot)
    model = mujoco.MjModel.from_xml_path(str(SHARED / "robot" / "g1_23dof_reference.xml"))
    data = mujoco.MjData(model)
    for tick in range(0, reference.num_ticks, 20):
        data.qpos[:3], data.qpos[3:7] = reference.root_pos_w[tick], reference.root_quat_wxyz[tick]
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        data.qvel[:3] = reference.root_lin_vel_w[tick]
        data.qvel[3:6] = turn.reshape(3, 3).T @ reference.root_ang_vel_w[tick]
        for i, name in enumerate(robot.joint_names):
            data.joint(name).qpos[0] = reference.joint_pos_rad[tick, i]
            data.joint(name).qvel[0] = reference.joint_vel_rad_s[tick, i]
        mujoco.mj_forward(model, data)
        for index, name in enumerate(robot.body_names):
            spatial = np.zeros(6)
            body = model.body(name).id
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, spatial, 0)
            np.testing.assert_allclose(reference.body_ang_vel_w[tick, index], spatial[:3], atol=1e-5, err_msg=name)
            np.testing.assert_allclose(reference.body_lin_vel_w[tick, index], spatial[3:], atol=1e-5, err_msg=name)


def test_body_velocities_are_the_rate_of_the_positions(standing_clip, robot):
    """A smooth motion at 200 fps: velocity against central differences of position over two control ticks."""
    t = np.arange(401) / 200.0
    joints = robot.default_pos_rad + 0.3 * np.sin(2.0 * t[:, None] + np.arange(23))
    root = np.stack([0.2 * np.sin(t), 0.3 * np.cos(t), 0.8 + 0.05 * np.sin(3.0 * t)], axis=1)
    half = 0.25 * np.sin(1.5 * t)
    quat = np.stack([np.cos(half), 0.6 * np.sin(half), 0.0 * t, 0.8 * np.sin(half)], axis=1)
    clip = standing_clip(401, 200.0, joint_pos_rad=joints, root_pos_w=root, root_quat_wxyz=quat)
    reference = build_reference(clip, robot)
    way = (reference.body_pos_w[2:] - reference.body_pos_w[:-2]) / 0.04
    np.testing.assert_allclose(reference.body_lin_vel_w[1:-1], way, atol=2e-3)
    assert np.abs(way).max() > 0.5
