"""From a file's axes to the world: which way is up in a recording, and where its ground is."""

from dataclasses import dataclass

import numpy as np

from core.errors import InputError
from core.rotations import normalize, quat_conjugate, quat_mul, quat_rotate
from motion.clip import MAX_ROOT_M
from motion.human.motion import ANKLES, JOINTS, HumanMotion
from motion.human.skeleton import FROM_SMPL_WXYZ, soles_w

_HALF = np.sqrt(0.5)
# Rotations that turn the axis of that name up.
UPRIGHT_WXYZ = {
    "x": quat_conjugate(FROM_SMPL_WXYZ),
    "y": FROM_SMPL_WXYZ,
    "z": np.array([1.0, 0.0, 0.0, 0.0]),
    "-x": np.array([_HALF, 0.0, _HALF, 0.0]),
    "-y": np.array([_HALF, -_HALF, 0.0, 0.0]),
    "-z": np.array([0.0, 1.0, 0.0, 0.0]),
}
CLEARLY_UPRIGHT = 0.7  # mean of the cosine between the body and an axis
LOWEST_JOINT_M = (-0.15, 0.3)  # where the lowest joint is for most of the time, if the ground is at zero
MAX_GROUND_RANGE_M = 0.5
GROUND_PERCENTILE = 5.0  # of soles over the frames: a few bad frames do not move the ground
MAX_LEVEL_M = 0.06  # between the sole points of a foot that stands: a slope of 14 degrees
MAX_STANDING_M_S = 0.3
MIN_STANDING_SHARE = 0.05  # of the frames
MAX_GROUND_M = 10.0
MAX_MEDIAN_SPEED_M_S = 15.0  # of the pelvis; beyond: surely not metres, or not this frame rate
_NECK = JOINTS.index("neck")


@dataclass(frozen=True, eq=False)
class FileMotion:
    """N frames as a file has them, in metres but in the file's own axes and with its own ground.

    pos_m (N,22,3); quat_wxyz (N,22,4) turns the T-pose of a HumanMotion into the segments in the file's axes; sole_m
    (2,4,3) and foot_m (2,3): see soles_w. `usual_up` is the axis that is up in things of this `kind` ("AMASS files").
    """

    fps: float
    pos_m: np.ndarray
    quat_wxyz: np.ndarray
    sole_m: np.ndarray
    foot_m: np.ndarray
    kind: str
    usual_up: str
    notes: tuple[str, ...]


def placed(recording: FileMotion, up: str | None, where: str, source: str) -> HumanMotion:
    """The recording in the world: z up, its lowest soles on the ground. `up`: see find_up.

    Raises InputError naming `where` when up or unit are in doubt.
    """
    away = np.argwhere(np.abs(recording.pos_m) > MAX_ROOT_M)
    if away.size:
        got = f"{recording.pos_m[tuple(away[0])]:.5g} m at {JOINTS[away[0, 1]]}"
        frame, expected = f"{where}: frame {away[0, 0]}", f"within {MAX_ROOT_M:g} m of the origin"
        raise InputError("too far away", where=frame, got=got, expected=expected, hint="is the unit right?")
    step_m = np.linalg.norm(np.diff(recording.pos_m[:, 0], axis=0), axis=1)
    speed_m_s = float(np.median(step_m)) * recording.fps
    if speed_m_s > MAX_MEDIAN_SPEED_M_S:
        expected = f"a median speed below {MAX_MEDIAN_SPEED_M_S:g} m/s"
        hint = "are unit and frame rate right?"
        raise InputError(
            "the pelvis is too fast", where=where, got=f"{speed_m_s:.5g} m/s", expected=expected, hint=hint
        )
    axis, up_note = find_up(recording.pos_m, recording.usual_up, recording.kind, up, where)
    upright = np.broadcast_to(UPRIGHT_WXYZ[axis], recording.quat_wxyz.shape)
    pos_w = quat_rotate(upright, recording.pos_m)
    quat_wxyz = normalize(quat_mul(upright, recording.quat_wxyz))
    sole_w = soles_w(recording.sole_m, recording.foot_m, pos_w, quat_wxyz)
    ground_m, ground_note = find_ground(sole_w, recording.fps, where)
    lift = np.array([0.0, 0.0, ground_m])
    return HumanMotion(
        fps=recording.fps,
        pos_w=pos_w - lift,
        quat_wxyz=quat_wxyz,
        sole_w=sole_w - lift,
        source=source,
        license="not stated in the file",
        notes=(*recording.notes, up_note, ground_note),
    )


def find_up(pos_m: np.ndarray, usual: str, kind: str, given: str | None, where: str) -> tuple[str, str]:
    """The axis of UPRIGHT_WXYZ that points up in joints (N,22,3) given in the file's axes, and a sentence about it.

    `usual` is the axis that points up in things of this `kind`. The body stands along the up-axis for most of the time;
    when that contradicts `usual`, the axis along which the lowest joint stays near zero, the ground, decides. `given`
    (one of UPRIGHT_WXYZ) ends the question. Raises InputError when it stays open.
    """
    if given is not None:
        if given not in UPRIGHT_WXYZ:
            raise InputError("unknown axis", where="up", got=given, expected=f"one of {', '.join(UPRIGHT_WXYZ)}")
        return given, f"Up is the axis {given}, as given."
    body = normalize(pos_m[:, _NECK] - pos_m[:, ANKLES].mean(axis=1)).mean(axis=0)
    number = int(np.argmax(np.abs(body)))
    along = "xyz"[number] if body[number] > 0.0 else f"-{'xyz'[number]}"
    share = f"{abs(body[number]):.2f} of upright in the mean"
    if along == usual:
        return usual, f"Up is the axis {usual}: the body stands along it ({share})."
    clear = abs(body[number]) >= CLEARLY_UPRIGHT
    if clear and _on_ground(pos_m, along) and not _on_ground(pos_m, usual):
        return along, f"Up is the axis {along}, not {usual} as in {kind}: the body stands along it ({share})."
    if not clear and _on_ground(pos_m, usual) and not _on_ground(pos_m, along):
        return usual, f"Up is the axis {usual}, as in {kind}; the body is not upright for long enough to tell."
    got = f"a body along the axis {along} ({share}), while {kind} have {usual} up"
    raise InputError("unclear which way is up", where=where, got=got, hint=f"say it: --up={usual} or --up={along}")


def find_ground(sole_w: np.ndarray, fps: float, where: str) -> tuple[float, str]:
    """Height of the ground under sole points (N,2,4,3), z up, and a sentence about it.

    It is where feet stand: level, still and low. A recorded foot is stiff, so that its tip lies below the ground when
    the person kneels; the lowest points count only where no foot stands. Raises InputError when the ground is so far
    from zero that the unit must be wrong.
    """
    height = sole_w[..., 2]
    speed = np.linalg.norm(np.gradient(sole_w.mean(axis=2), axis=0), axis=-1) * fps
    level = height.max(axis=-1) - height.min(axis=-1) <= MAX_LEVEL_M
    standing = height.mean(axis=-1)[level & (speed <= MAX_STANDING_M_S)]
    if len(standing) >= MIN_STANDING_SHARE * len(height):
        low = standing <= np.percentile(standing, GROUND_PERCENTILE) + MAX_LEVEL_M
        ground, what = float(np.median(standing[low])), "standing soles"
    else:
        ground, what = float(np.percentile(height.min(axis=(1, 2)), GROUND_PERCENTILE)), "lowest soles"
    if abs(ground) > MAX_GROUND_M:
        expected = f"soles within {MAX_GROUND_M:g} m of height zero"
        hint = "is the unit of the positions right?"
        raise InputError("far from the ground", where=where, got=f"{ground:.5g} m", expected=expected, hint=hint)
    if abs(ground) < 0.0005:
        return ground, f"The ground is the file's height zero: the {what} are there."
    moved = f"{'lowered' if ground > 0.0 else 'raised'} by {abs(ground):.3f} m"
    return ground, f"The whole motion was {moved}, so that the {what} are on the ground."


def _on_ground(pos_m: np.ndarray, axis: str) -> bool:
    """Whether the lowest joint keeps near zero along `axis`."""
    sign = -1.0 if axis.startswith("-") else 1.0
    low, middle, high = np.percentile((sign * pos_m[..., "xyz".index(axis[-1])]).min(axis=1), (5.0, 50.0, 95.0))
    return bool(LOWEST_JOINT_M[0] <= middle <= LOWEST_JOINT_M[1] and high - low <= MAX_GROUND_RANGE_M)
