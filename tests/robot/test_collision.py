"""What touches what on the G1."""

import mujoco
import numpy as np
import pytest

from robot.robot import load_robot
from world.model import compile_model


@pytest.fixture(scope="module")
def robot():
    return load_robot()


@pytest.fixture(scope="module")
def model(robot):
    return compile_model(robot, timestep_s=0.005, strip_visuals=True)


def _touching(model, robot, *, height_m=3.0, **angles):
    """Pairs of geoms in contact in the default pose with some joints at other angles."""
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = height_m, robot.default_pos_rad
    for name, value in angles.items():
        data.qpos[7 + robot.joint_names.index(f"{name}_joint")] = value
    mujoco.mj_forward(model, data)
    return {frozenset(model.geom(g).name for g in contact.geom) for contact in data.contact[: data.ncon]}


def test_default_and_zero_pose_are_free(robot, model):
    assert not _touching(model, robot)
    assert not _touching(model, robot, **{name.removesuffix("_joint"): 0.0 for name in robot.joint_names})


def test_links_of_one_limb_never_meet(robot, model):
    """Whatever the elbows, knees and ankles do, with the limbs held away from everything else."""
    apart = {"left_shoulder_roll": 1.0, "right_shoulder_roll": -1.0, "left_hip_roll": 0.4, "right_hip_roll": -0.4}
    for name, lower, upper in zip(robot.joint_names, robot.pos_lower_rad, robot.pos_upper_rad):
        if any(part in name for part in ("elbow", "knee", "ankle", "waist")):
            for angle in np.linspace(0.9 * lower, 0.9 * upper, 9):
                assert not _touching(model, robot, **{**apart, name.removesuffix("_joint"): angle}), (name, angle)


def test_feet_together_and_hands_before_the_belly_are_free(robot, model):
    together = np.arcsin(0.0665 / 0.68)  # ankles 0.1 m apart
    feet = {"left_hip_roll": -together, "right_hip_roll": together}
    feet |= {"left_ankle_roll": together, "right_ankle_roll": -together}
    assert not _touching(model, robot, **feet)
    hands = {"elbow": 0.3, "shoulder_pitch": 0.3, "shoulder_yaw": 0.6}
    pose = {f"{side}_{key}": value for side in ("left", "right") for key, value in hands.items()}
    pose |= {"right_shoulder_yaw": -hands["shoulder_yaw"]}
    assert not _touching(model, robot, **pose)


MEETINGS = {
    "arm and torso": ({"left_shoulder_roll": -0.6}, "left_upper_arm", "chest"),
    "hand and hip": (
        {"left_shoulder_roll": -0.15, "left_elbow": 1.2, "left_shoulder_pitch": 0.2},
        "left_hand",
        "left_hip",
    ),
    "hand and thigh": (
        {"left_hip_pitch": -1.2, "left_knee": 1.2, "left_elbow": 0.6, "left_shoulder_roll": 0.0},
        "left_hand",
        "left_thigh",
    ),
    "hand and hand": (
        {"left_shoulder_yaw": -0.75, "right_shoulder_yaw": 0.75, "left_elbow": 0.3, "right_elbow": 0.3},
        "left_hand",
        "right_hand",
    ),
    "shin and shin": ({"left_hip_roll": -0.3, "right_hip_roll": 0.3}, "left_shin", "right_shin"),
    "foot and foot": ({"left_hip_roll": -0.14, "right_hip_roll": 0.14}, "left_foot", "right_foot"),
    "thigh and torso": ({"left_hip_pitch": -2.5, "waist_pitch": 0.5}, "left_thigh", "belly"),
}


@pytest.mark.parametrize("name", MEETINGS)
def test_limbs_that_meet_touch(robot, model, name):
    angles, first, second = MEETINGS[name]
    pairs = _touching(model, robot, **angles)
    assert any(any(first in a for a in pair) and any(second in b for b in pair) for pair in pairs), pairs


def test_foot_friction_is_what_the_floor_contact_gets(robot):
    """Randomising a foot's sliding friction is literal: the floor's own does not mix in."""

    def slippery(spec):
        for geom in spec.body("left_ankle_roll_link").geoms:
            geom.friction[0] = 0.35

    model = compile_model(robot, timestep_s=0.005, edit=slippery)
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = 0.776, robot.default_pos_rad
    mujoco.mj_forward(model, data)
    found = {}
    for contact in data.contact[: data.ncon]:
        assert contact.dim == 3
        side = "left" if any("left" in model.geom(g).name for g in contact.geom) else "right"
        found.setdefault(side, set()).add((round(contact.friction[0], 9), round(contact.friction[1], 9)))
    assert found == {"left": {(0.35, 0.35)}, "right": {(1.0, 1.0)}}


def test_only_the_soles_carry_a_standing_robot(robot, model):
    data = mujoco.MjData(model)
    data.qpos[2], data.qpos[7:] = 0.778, robot.default_pos_rad
    for _ in range(60):
        torque = robot.kp * (robot.default_pos_rad - data.qpos[7:]) - robot.kd * data.qvel[6:]
        data.ctrl[:] = np.clip(torque, -robot.torque_limit_nm, robot.torque_limit_nm)
        mujoco.mj_step(model, data)
        for contact in data.contact[: data.ncon]:
            assert {"floor", "sole"} == {model.geom(g).name.split("_")[-2:][0] for g in contact.geom}
    force = np.zeros(6)
    weight = 0.0
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        weight += force[0]
    assert np.isclose(weight, 9.81 * model.body_mass.sum(), rtol=0.1)


@pytest.mark.parametrize("body", ["torso_link", "pelvis", "left_knee_link", "left_elbow_link", "left_hip_yaw_link"])
def test_a_fallen_robot_lies_on_the_floor(robot, model, body):
    """Dropped on its face, nothing sinks: every solid of ``body`` stays above the floor."""
    data = mujoco.MjData(model)
    data.qpos[2:7], data.qpos[7:] = [0.4, np.sqrt(0.5), 0, np.sqrt(0.5), 0], robot.default_pos_rad
    for _ in range(300):
        data.ctrl[:] = -2.0 * data.qvel[6:]
        mujoco.mj_step(model, data)
    floor = model.geom("floor").id
    solids = np.flatnonzero(model.geom_bodyid == model.body(body).id)
    gaps = [mujoco.mj_geomDistance(model, data, floor, int(g), 1.0, None) for g in solids]
    assert min(gaps) > -0.01
