"""Actors of one constant target for the real robot, each with a clip of standing still."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from motion.clip import Clip, clip_to_bytes
from motion.importers.g1_joints import JOINTS_23
from policy.metadata import write_metadata
from policy.spec import ActorSpec, MotionInfo, ObservationGroup, ObservationTerm
from robot.robot import load_robot
from tests.policy.toys import write_graph
from world.model import compile_model

ROBOT = load_robot()
OBSERVATION = ObservationGroup("obs", (ObservationTerm("dof_pos", (0,)), ObservationTerm("base_ang_vel", (0,))))
SIZE = ROBOT.num_joints + 3


def save_csv(clip, path):
    """As robots' recordings are: root, quaternion with w last, 23 joints in the maker's order; no frame rate."""
    order = [clip.joint_names.index(name) for name in JOINTS_23]
    quat_xyzw = np.roll(clip.root_quat_wxyz, -1, axis=1)
    np.savetxt(path, np.hstack([clip.root_pos_w, quat_xyzw, clip.joint_pos_rad[:, order]]), delimiter=",")


def standing_clip(duration_s: float) -> Clip:
    """The default pose, the soles on the ground."""
    model = compile_model(ROBOT, timestep_s=0.001)
    data = mujoco.MjData(model)
    data.qpos[:] = [0, 0, 1, 1, 0, 0, 0, *ROBOT.default_pos_rad]
    mujoco.mj_kinematics(model, data)
    soles = [
        data.body(foot).xpos + data.body(foot).xmat.reshape(3, 3) @ point
        for foot in ROBOT.feet
        for point in ROBOT.sole_points_m[foot]
    ]
    frames = round(30 * duration_s) + 1
    return Clip(
        fps=30.0,
        joint_names=ROBOT.joint_names,
        root_pos_w=np.tile([0.0, 0.0, 1.0 - min(point[2] for point in soles)], (frames, 1)),
        root_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)),
        joint_pos_rad=np.tile(ROBOT.default_pos_rad, (frames, 1)),
        contact=np.ones((frames, 2)),
        source="stands still",
    )


def write_still_actor(
    path: Path,
    duration_s: float = 0.4,
    offsets_rad: dict[str, float] | None = None,
    any_clip: bool = False,
    provenance: dict[str, Any] | None = None,
) -> Path:
    """An actor whose target is the default pose plus `offsets_rad`, whatever it observes."""
    action = np.zeros(ROBOT.num_joints, dtype=np.float32)
    for name, offset in (offsets_rad or {}).items():
        action[ROBOT.joint_names.index(name)] = offset / 0.25
    zeros = [np.zeros(shape, dtype=np.float32) for shape in ((4, SIZE), (4,), (ROBOT.num_joints, 4))]
    write_graph(path, SIZE, ROBOT.num_joints, params=[*zeros, action])
    clip = standing_clip(duration_s)
    motion = MotionInfo(
        name="still",
        fps=clip.fps,
        num_frames=clip.num_frames,
        duration_s=clip.duration_s,
        sha256=clip.sha256,
        root_height_m=float(clip.root_pos_w[0, 2]),
        start_joint_pos_rad=clip.joint_pos_rad[0],
    )
    spec = ActorSpec(
        robot=ROBOT.name,
        joint_names=ROBOT.joint_names,
        default_pos_rad=ROBOT.default_pos_rad,
        kp=ROBOT.kp,
        kd=ROBOT.kd,
        action_scale=np.full(ROBOT.num_joints, 0.25),
        action_clip=100.0,
        control_period_s=0.02,
        observations=(OBSERVATION,),
        motion=None if any_clip else motion,
        follows="any_clip" if any_clip else "clip",
        provenance=provenance or {},
    )
    write_metadata(path, spec, None if any_clip else clip_to_bytes(clip))
    return path
