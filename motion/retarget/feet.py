"""Where the feet go: fixed while they stand, on the way that was asked for while they swing."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from core.rotations import quat_conjugate, quat_from_rotvec, quat_mul, quat_rotate, quat_to_rotvec, yaw_of, yaw_quat
from motion.physics_checks import bridged, phases
from motion.retarget.settings import FeetSettings
from robot.kinematics import TrackedPoint
from robot.robot import Robot

SMALL_SHIFT_M = 0.01  # feet that both shift less count alike


@dataclass(frozen=True, eq=False)
class FeetPlan:
    """Both feet: places sole_w (N,2,3) of the middles of their soles, rotations (N,2,4), and weights (N,2) of both.

    root_shift_w (N,3) is how far, along the ground, the root has to go with the standing feet.
    """

    sole_w: np.ndarray
    quat_wxyz: np.ndarray
    place_weight: np.ndarray
    turn_weight: np.ndarray
    root_shift_w: np.ndarray


def sole_middles(robot: Robot) -> tuple[TrackedPoint, TrackedPoint]:
    """The middle of the left and of the right sole."""
    left, right = (
        TrackedPoint(f"sole of {foot}", foot, tuple(robot.sole_points_m[foot].mean(axis=0))) for foot in robot.feet
    )
    return left, right


def plan_feet(
    pos_w: np.ndarray, quat_wxyz: np.ndarray, contact: np.ndarray, fps: float, robot: Robot, settings: FeetSettings
) -> FeetPlan:
    """Plan of both feet from free paths (N,2,3) and rotations (N,2,4) of their bodies; contact (N,2) above 0.5 stands.

    The bodies' x axes point to the toes and z up when the soles are flat.

    Holding a foot that slides takes the body along: the root and a swinging foot go as far as the standing feet do,
    mostly as the one that slides less. Weights go smoothly, in ratio, from a swinging foot's to a standing one's.
    """
    feet = [
        plan_foot(pos_w[:, i], quat_wxyz[:, i], contact[:, i] > 0.5, robot.sole_points_m[foot], fps, settings)
        for i, foot in enumerate(robot.feet)
    ]
    quat = np.stack([rotation for _, rotation in feet], axis=1)
    middle = np.broadcast_to([point.offset_m for point in sole_middles(robot)], pos_w.shape)
    before = pos_w + quat_rotate(quat_wxyz, middle)
    after = np.stack([place for place, _ in feet], axis=1) + quat_rotate(quat, middle)
    firm = np.stack([_firmness(standing > 0.5, fps, settings) for standing in contact.T], axis=1)
    shift = _common_shift((after - before) * [1.0, 1.0, 0.0], firm)
    return FeetPlan(
        sole_w=after + (1.0 - firm[..., None]) * shift[:, None],
        quat_wxyz=quat,
        place_weight=settings.swing_position_weight ** (1.0 - firm) * settings.contact_position_weight**firm,
        turn_weight=settings.swing_rotation_weight ** (1.0 - firm) * settings.contact_rotation_weight**firm,
        root_shift_w=shift,
    )


def plan_foot(
    pos_w: np.ndarray,
    quat_wxyz: np.ndarray,
    standing: np.ndarray,
    sole_m: np.ndarray,
    fps: float,
    settings: FeetSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """Path (N,3) and rotations (N,4) of one foot body that stands where `standing` (N,), from a free path.

    While it stands, its sole (points sole_m (S,3) in the body) lies on the ground, its middle at the median of the
    phase; it may still roll over heel or toes, and turn. The correction that this takes fades out and in where the foot
    swings.
    """
    plan_pos, plan_quat = pos_w.copy(), quat_wxyz.copy()
    runs = phases(bridged(standing, fps, settings.bridged_gap_s))
    for first, end in runs:
        run = slice(first, end)
        plan_pos[run], plan_quat[run] = _standing(pos_w[run], quat_wxyz[run], sole_m, settings)
    shift = plan_pos - pos_w
    turn = quat_to_rotvec(quat_mul(plan_quat, quat_conjugate(quat_wxyz)))
    for frames, source, weight in _fades(runs, len(pos_w), _fade_frames(fps, settings)):
        shift[frames] += weight * shift[source]
        turn[frames] += weight * turn[source]
    return pos_w + shift, quat_mul(quat_from_rotvec(turn), quat_wxyz)


def _common_shift(shift_w: np.ndarray, firm: np.ndarray) -> np.ndarray:
    """One shift (N,3) for the body from those of the feet (N,2,3), as far as they stand (N,2)."""
    share = firm / (np.linalg.norm(shift_w, axis=-1) + SMALL_SHIFT_M)
    share *= firm.max(axis=1, keepdims=True) / np.maximum(share.sum(axis=1, keepdims=True), 1e-9)
    return (shift_w * share[..., None]).sum(axis=1)


def _firmness(standing: np.ndarray, fps: float, settings: FeetSettings) -> np.ndarray:
    """1 where a foot stands (N,), falling to 0 within the time of fading before and after."""
    from scipy.ndimage import distance_transform_edt  # see motion.inverse_dynamics

    if not standing.any():
        return np.zeros(len(standing))
    return _faded(distance_transform_edt(~standing) / _fade_frames(fps, settings))


def _standing(
    pos_w: np.ndarray, quat_wxyz: np.ndarray, sole_m: np.ndarray, settings: FeetSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Path and rotations of one phase: laid flat about the lowest point, anchored, tilted again about that point."""
    soles = _rotated(quat_wxyz, sole_m)
    flat = yaw_quat(quat_wxyz)
    pivot = soles[..., 2].argmin(axis=1)
    laid = pos_w + _of(soles, pivot) - _of(_rotated(flat, sole_m), pivot)
    middle = laid + quat_rotate(flat, np.broadcast_to(sole_m.mean(axis=0), laid.shape))
    heading = _held_heading(yaw_of(quat_wxyz), settings.held_turn_rad)
    flat = quat_from_rotvec(heading[:, None] * np.array([0.0, 0.0, 1.0]))
    tilted = quat_mul(flat, _pitch(quat_mul(quat_conjugate(yaw_quat(quat_wxyz)), quat_wxyz), settings))
    flat_soles, soles = _rotated(flat, sole_m), _rotated(tilted, sole_m)
    pivot = soles[..., 2].argmin(axis=1)
    place = np.append(np.median(middle[:, :2], axis=0), 0.0) - flat_soles.mean(axis=1)
    place[:, 2] = -flat_soles[..., 2].min(axis=1)
    return place + _of(flat_soles, pivot) - _of(soles, pivot), tilted


def _held_heading(yaw_rad: np.ndarray, held_turn_rad: float) -> np.ndarray:
    """Heading (N,) of a standing foot: the median unless it really turns."""
    yaw = np.unwrap(yaw_rad)
    return np.full_like(yaw, np.median(yaw)) if np.ptp(yaw) < held_turn_rad else yaw


def _pitch(tilt_wxyz: np.ndarray, settings: FeetSettings) -> np.ndarray:
    """The part of a tilt (N,4) about the foot's y axis, less what counts as flat, within the largest tilt allowed."""
    pitch = quat_to_rotvec(tilt_wxyz)[:, 1]
    kept = np.clip(np.abs(pitch) - settings.flat_below_rad, 0.0, settings.max_tilt_rad) * np.sign(pitch)
    return quat_from_rotvec(kept[:, None] * np.array([0.0, 1.0, 0.0]))


def _rotated(quat_wxyz: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Points (S,3) turned by each of N rotations: (N,S,3)."""
    shape = (len(quat_wxyz), *points_m.shape)
    return quat_rotate(np.repeat(quat_wxyz[:, None], len(points_m), axis=1), np.broadcast_to(points_m, shape))


def _of(points: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Point number index (N,) of each row of points (N,S,3)."""
    return points[np.arange(len(points)), index]


def _fades(runs: list[tuple[int, int]], num_frames: int, fade: float) -> Iterator[tuple[np.ndarray, int, np.ndarray]]:
    """(frames (K,), frame whose correction they take, weights (K,1)) before and after each phase of standing."""
    for i, (first, end) in enumerate(runs):
        before = runs[i - 1][1] if i else 0
        after = runs[i + 1][0] if i + 1 < len(runs) else num_frames
        sides = ((np.arange(before, first), first, i > 0), (np.arange(end, after), end - 1, after < num_frames))
        for frames, source, between in sides:
            length = min(fade, len(frames) + 1) if between else fade
            yield frames, source, _faded(np.abs(frames - source) / length)[:, None]


def _fade_frames(fps: float, settings: FeetSettings) -> float:
    return max(settings.fade_s * fps, 1.0)


def _faded(part: np.ndarray) -> np.ndarray:
    """From 1 at 0 to 0 at 1 and beyond, smoothly."""
    part = np.clip(part, 0.0, 1.0)
    return 1.0 - part**2 * (3.0 - 2.0 * part)
