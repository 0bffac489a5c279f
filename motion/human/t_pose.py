"""How the segments of a file's skeleton stand against the T-pose of the mean skeleton."""

from dataclasses import dataclass

import mujoco
import numpy as np

from core.errors import InputError
from core.rotations import cross, normalize, quat_from_axis_angle, quat_mul, quat_rotate, quat_rotate_inverse
from motion.human.motion import ANKLES, JOINTS
from motion.human.skeleton import FEET, MEAN_SKELETON

# Bones whose direction in the T-pose is known, by the joint they begin at and the one they lead to.
BONES = tuple(
    (JOINTS.index(f"{side}_{joint}"), JOINTS.index(f"{side}_{child}"))
    for side in ("left", "right")
    for joint, child in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
)
MAX_TILT_DEG = 25.0  # of the T-pose against the axes of the file
MAX_LIMB_DEG = 120.0  # of a limb against the T-pose: beyond, left and right are exchanged
MAX_FOOT_DEG = 40.0
MIN_SIDEWAYS = 0.5  # part of a limb's direction across the forward axis
_HANDS = tuple((JOINTS.index(f"{side}_wrist"), JOINTS.index(f"{side}_elbow")) for side in ("left", "right"))
_HIPS = (JOINTS.index("left_hip"), JOINTS.index("right_hip"))
_NECK = JOINTS.index("neck")
_TOE = 3
# Where the ball of the foot lies on the way from the ankle to the tip of the toes.
TOE_SHARE = MEAN_SKELETON.offset_m[FEET[0], 0] / MEAN_SKELETON.sole_m[0, _TOE, 0]


@dataclass(frozen=True, eq=False)
class TPose:
    """segment_wxyz (22,4) turns the T-pose of a HumanMotion into the segments of the file's own T-pose, in the file's
    axes; body_wxyz (4,) does so for the body as a whole. `up` is the axis of the file that points up there."""

    segment_wxyz: np.ndarray
    body_wxyz: np.ndarray
    up: str


def t_pose_of(pos_m: np.ndarray, where: str) -> TPose:
    """Of the joints (22,3) in the file's T-pose, which stands flat-footed with straight legs, arms at any height.

    Arms and legs count by the direction of their bones, each turned about the forward axis; hands go on as the forearms
    do; the trunk, the head and the feet stand as in the T-pose. Raises InputError when it is no such pose.
    """
    body, up = _body(pos_m, where)
    segment = np.tile(body, (len(JOINTS), 1))
    for joint, child in BONES:
        wanted = normalize(MEAN_SKELETON.offset_m[child])
        there = quat_rotate_inverse(body, _direction(pos_m, joint, child, where))
        _check_angle(wanted, there, MAX_LIMB_DEG, f"{where}: {JOINTS[joint]}", "are left and right exchanged?")
        segment[joint] = quat_mul(body, _limb_turn(wanted, there))
    for hand, forearm in _HANDS:
        segment[hand] = segment[forearm]
    for ankle, foot in zip(ANKLES, FEET, strict=True):
        wanted = quat_rotate(body, normalize(MEAN_SKELETON.offset_m[foot]))
        there = _direction(pos_m, ankle, foot, where)
        hint = "the T-pose must stand flat-footed: give t_pose in the mapping"
        _check_angle(wanted, there, MAX_FOOT_DEG, f"{where}: {JOINTS[ankle]}", hint)
    return TPose(segment, body, up)


def feet_of(
    pos_m: np.ndarray, pose: TPose, leg_m: float, *, at_toe: bool, above_sole_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Sole points (2,4,3) and foot joints (2,3) from the ankles, in the axes of the T-pose of a HumanMotion.

    The mean soles at the size of the leg, as deep below the ankle as the file's foot joint and `above_sole_m` say. A
    foot joint `at_toe`, the tip, is moved back to the ball of the foot.
    """
    body = np.broadcast_to(pose.body_wxyz, (2, 4))
    foot = quat_rotate_inverse(body, pos_m[list(FEET)] - pos_m[list(ANKLES)])
    mean_leg_m = sum(float(np.linalg.norm(MEAN_SKELETON.offset_m[child])) for _, child in BONES[:2])
    sole = MEAN_SKELETON.sole_m * (leg_m / mean_leg_m)
    sole[..., 2] = (foot[:, 2] - above_sole_m)[:, None]
    return sole, foot * (TOE_SHARE if at_toe else 1.0)


def _body(pos_m: np.ndarray, where: str) -> tuple[np.ndarray, str]:
    """Rotation (4,) of the whole body, along the axes of the file, and the name of the axis that points up."""
    wanted = {"left": pos_m[_HIPS[0]] - pos_m[_HIPS[1]], "up": pos_m[_NECK] - pos_m[list(ANKLES)].mean(axis=0)}
    axes = {}
    for name, direction in wanted.items():
        direction = normalize(direction)
        axes[name] = np.eye(3)[np.argmax(np.abs(direction))] * np.sign(direction[np.argmax(np.abs(direction))])
        hint = "the zero pose is no T-pose: give one as t_pose in the mapping (--skeleton)"
        _check_angle(axes[name], direction, MAX_TILT_DEG, f"{where}: the body's {name} in the T-pose", hint)
    columns = np.stack([cross(axes["left"], axes["up"]), axes["left"], axes["up"]], axis=-1)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, columns.ravel())
    number = int(np.argmax(np.abs(axes["up"])))
    return quat, ("" if axes["up"][number] > 0 else "-") + "xyz"[number]


def _direction(pos_m: np.ndarray, joint: int, child: int, where: str) -> np.ndarray:
    bone = pos_m[child] - pos_m[joint]
    if np.linalg.norm(bone) < 1e-3:
        names = f"{JOINTS[joint]} and {JOINTS[child]}"
        raise InputError("joints at one place", where=where, got=names, expected="a bone between them")
    return normalize(bone)


def _check_angle(wanted: np.ndarray, there: np.ndarray, limit_deg: float, where: str, hint: str) -> None:
    angle_deg = float(np.degrees(np.arccos(np.clip(wanted @ there, -1.0, 1.0))))
    if angle_deg > limit_deg:
        expected = f"within {limit_deg:g} degrees"
        raise InputError("no T-pose", where=where, got=f"{angle_deg:.0f} degrees off", expected=expected, hint=hint)


def _limb_turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The rotation (4,) of a limb from direction `start` to `end`, in the axes of the T-pose.

    Arms are lowered and legs spread about the forward axis; what is left goes the shortest way. A limb that points
    forward goes the shortest way at once.
    """
    if min(np.hypot(*start[1:]), np.hypot(*end[1:])) < MIN_SIDEWAYS:
        return _shortest_turn(start, end)
    angle_rad = np.arctan2(end[2], end[1]) - np.arctan2(start[2], start[1])
    aside = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(angle_rad))
    return quat_mul(_shortest_turn(quat_rotate(aside, start), end), aside)


def _shortest_turn(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The rotation (4,) by the smallest angle that turns unit vector `start` into `end`, not its opposite."""
    return normalize(np.concatenate([[1.0 + start @ end], cross(start, end)]))
