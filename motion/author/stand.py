"""The stand pose: default joint positions, level pelvis, soles on the ground. Every clip begins and ends in it."""

from dataclasses import dataclass

import mujoco
import numpy as np

from robot.robot import Robot
from world.model import compile_model

SIDES = ("left", "right")
TORSO_BODY = "torso_link"
SHOULDER_BODY = "{side}_shoulder_roll_link"
HAND_POINT = "{side}_hand_link"
ELBOW_REFERENCE = np.array([-0.6, 0.0, -0.8])  # where an elbow of swivel 0 points: down and back, in the torso frame


@dataclass(frozen=True, eq=False)
class ArmGeometry:
    """One arm in the stand pose, in the torso frame (m): shoulder, elbow and hand (3,); `outward` is +1 left, -1 right.

    elbow_body carries the hand point at hand_offset_m (3,).
    """

    elbow_body: str
    hand_offset_m: np.ndarray
    shoulder_m: np.ndarray
    elbow_m: np.ndarray
    hand_m: np.ndarray
    outward: float

    def elbow_at(self, hand_m: np.ndarray, swivel_rad: float) -> np.ndarray:
        """Elbow (3,) for a hand (3,), turned outwards by `swivel_rad` about shoulder to hand, from down and back."""
        upper, lower = np.linalg.norm(self.elbow_m - self.shoulder_m), np.linalg.norm(self.hand_m - self.elbow_m)
        reach = hand_m - self.shoulder_m
        distance = np.clip(np.linalg.norm(reach), abs(upper - lower) + 1e-6, upper + lower - 1e-6)
        axis = reach / np.linalg.norm(reach)
        along = (distance**2 + upper**2 - lower**2) / (2.0 * distance)
        radius = np.sqrt(max(upper**2 - along**2, 0.0))
        down = ELBOW_REFERENCE - axis * (ELBOW_REFERENCE @ axis)
        down /= np.linalg.norm(down)
        side = self.outward * np.cross(axis, down)
        return self.shoulder_m + along * axis + radius * (np.cos(swivel_rad) * down + np.sin(swivel_rad) * side)

    def swivel_rad(self) -> float:
        """Swivel of the stand pose."""
        reach = self.hand_m - self.shoulder_m
        axis = reach / np.linalg.norm(reach)
        down = ELBOW_REFERENCE - axis * (ELBOW_REFERENCE @ axis)
        down /= np.linalg.norm(down)
        bend = self.elbow_m - self.shoulder_m
        return float(np.arctan2(bend @ (self.outward * np.cross(axis, down)), bend @ down))


@dataclass(frozen=True, eq=False)
class StandPose:
    """qpos (7+J,) with the pelvis above the world origin, and what hangs on it: com_m (3,), foot positions (2,3),

    middle of each sole in its foot's frame (2,2), arms by side. `model` knows no contacts, and its joint ranges are
    shrunk to the soft limits.
    """

    model: mujoco.MjModel
    qpos: np.ndarray
    com_m: np.ndarray
    foot_pos_w: np.ndarray
    sole_middle_m: np.ndarray
    arms: dict[str, ArmGeometry]


def stand_pose(robot: Robot) -> StandPose:
    """The stand pose of `robot`, measured on its own model."""
    model = compile_model(robot, timestep_s=0.02)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.jnt_range[1:, 0], model.jnt_range[1:, 1] = robot.soft_pos_limits_rad()
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate(([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], robot.default_pos_rad))
    mujoco.mj_kinematics(model, data)
    soles = [data.body(f).xpos + robot.sole_points_m[f] @ data.body(f).xmat.reshape(3, 3).T for f in robot.feet]
    data.qpos[2] = -min(sole[:, 2].min() for sole in soles)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    middles = [0.5 * (robot.sole_points_m[f].min(0) + robot.sole_points_m[f].max(0))[:2] for f in robot.feet]
    return StandPose(
        model=model,
        qpos=data.qpos.copy(),
        com_m=data.subtree_com[1].copy(),
        foot_pos_w=np.array([data.body(f).xpos for f in robot.feet]),
        sole_middle_m=np.array(middles),
        arms={side: _arm(robot, data, side) for side in SIDES},
    )


def _arm(robot: Robot, data: mujoco.MjData, side: str) -> ArmGeometry:
    point = next(p for p in robot.points if p.name == HAND_POINT.format(side=side))
    torso, elbow = data.body(TORSO_BODY), data.body(point.parent)
    hand_w = elbow.xpos + elbow.xmat.reshape(3, 3) @ np.asarray(point.offset_m)
    points_w = (data.body(SHOULDER_BODY.format(side=side)).xpos, elbow.xpos, hand_w)
    shoulder, bend, hand = (torso.xmat.reshape(3, 3).T @ (p - torso.xpos) for p in points_w)
    return ArmGeometry(
        elbow_body=point.parent,
        hand_offset_m=np.asarray(point.offset_m),
        shoulder_m=shoulder,
        elbow_m=bend,
        hand_m=hand,
        outward=1.0 if side == "left" else -1.0,
    )
