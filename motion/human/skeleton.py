"""The mean human: where the joints of SMPL lie in the T-pose, the soles under them, and how rotations move them."""

from dataclasses import dataclass

import numpy as np

from core.rotations import normalize, quat_mul, quat_rotate
from motion.human.motion import ANKLES, JOINTS, PARENTS

FEET = (JOINTS.index("left_foot"), JOINTS.index("right_foot"))
# Turns SMPL's axes (x left, y up, z forward) into those of a HumanMotion (x forward, y left, z up).
FROM_SMPL_WXYZ = np.array([0.5, 0.5, 0.5, 0.5])

# From the parent joint, in metres: the neutral SMPL body of mean shape, figures as published in the MuJoCo humanoid of
# that shape (smpl_humanoid.xml of the PHC and ProtoMotions projects, which follows the J_regressor of the model).
# Left and right are the mean of both sides, mirrored; spine, neck and head lie in the middle.
_CENTER_M = {
    "spine1": (-0.0267, 0.0, 0.1090),
    "spine2": (0.0011, 0.0, 0.1352),
    "spine3": (0.0254, 0.0, 0.0529),
    "neck": (-0.0429, 0.0, 0.2139),
    "head": (0.0513, 0.0, 0.0650),
}
_LEFT_M = {
    "hip": (-0.0056, 0.0686, -0.0910),
    "knee": (-0.0067, 0.0363, -0.3789),
    "ankle": (-0.0430, -0.0147, -0.3982),
    "foot": (0.1213, 0.0259, -0.0520),
    "collar": (-0.0364, 0.0803, 0.1203),
    "shoulder": (-0.0090, 0.0935, 0.0316),
    "elbow": (-0.0245, 0.2567, -0.0131),
    "wrist": (-0.0034, 0.2523, 0.0084),
}
# SOLE_POINTS of the left foot from its ankle in the T-pose, from the foot boxes of the same file: the sole lies 0.070
# below the ankle and reaches from 0.061 behind it to 0.193 in front; a little less where the foot is round.
_LEFT_SOLE_M = ((-0.055, 0.010, -0.070), (0.121, -0.015, -0.070), (0.105, 0.065, -0.070), (0.190, 0.020, -0.070))
_TOE = 3  # of the SOLE_POINTS; it turns with the foot joint, the others with the ankle
_MIRROR = np.array([1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A body in the T-pose. offset_m (22,3): each joint from its parent, the pelvis zero.

    sole_m (2,4,3): SOLE_POINTS of both feet from their ankle.
    """

    offset_m: np.ndarray
    sole_m: np.ndarray

    def t_pose_m(self) -> np.ndarray:
        """Joints (22,3) in the T-pose, the pelvis at the origin."""
        place = np.zeros((len(JOINTS), 3))
        for joint, parent in enumerate(PARENTS[1:], start=1):
            place[joint] = place[parent] + self.offset_m[joint]
        return place


def _mean_skeleton() -> Skeleton:
    offset = np.zeros((len(JOINTS), 3))
    for index, name in enumerate(JOINTS[1:], start=1):
        side, _, part = name.rpartition("_")
        offset[index] = _CENTER_M[name] if not side else np.array(_LEFT_M[part]) * (1.0 if side == "left" else _MIRROR)
    sole = np.array([_LEFT_SOLE_M, np.array(_LEFT_SOLE_M) * _MIRROR])
    for array in (offset, sole):
        array.setflags(write=False)
    return Skeleton(offset, sole)


MEAN_SKELETON = _mean_skeleton()


def posed(skeleton: Skeleton, pelvis_w: np.ndarray, local_wxyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Forward kinematics: joints (N,22,3) and segments (N,22,4) of a HumanMotion.

    pelvis_w (N,3) m; local_wxyz (N,22,4) turns each joint against its parent, the pelvis against the world, in the
    axes of the T-pose (x forward, y left, z up).
    """
    shape = local_wxyz.shape[:2]
    pos_w, quat_wxyz = np.empty((*shape, 3)), np.empty((*shape, 4))
    pos_w[:, 0], quat_wxyz[:, 0] = pelvis_w, local_wxyz[:, 0]
    for joint, parent in enumerate(PARENTS[1:], start=1):
        offset = np.broadcast_to(skeleton.offset_m[joint], (shape[0], 3))
        pos_w[:, joint] = pos_w[:, parent] + quat_rotate(quat_wxyz[:, parent], offset)
        quat_wxyz[:, joint] = normalize(quat_mul(quat_wxyz[:, parent], local_wxyz[:, joint]))
    return pos_w, quat_wxyz


def soles_w(sole_m: np.ndarray, foot_m: np.ndarray, pos_w: np.ndarray, quat_wxyz: np.ndarray) -> np.ndarray:
    """Sole points (N,2,4,3) of joints (N,22,3) and segments (N,22,4).

    sole_m (2,4,3) and foot_m (2,3): the points and the foot joint from the ankle in the T-pose. The toe turns with the
    foot joint, the other points with the ankle.
    """
    points = np.empty((len(pos_w), *sole_m.shape))
    for side, (ankle, foot) in enumerate(zip(ANKLES, FEET, strict=True)):
        for point in range(sole_m.shape[1]):
            base = foot if point == _TOE else ankle
            offset = sole_m[side, point] - (foot_m[side] if point == _TOE else 0.0)
            turned = quat_rotate(quat_wxyz[:, base], np.broadcast_to(offset, (len(pos_w), 3)))
            points[:, side, point] = pos_w[:, base] + turned
    return points
