"""Knots -> one row of body targets per frame."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d

from core.errors import InputError
from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate
from motion.author.balance import com_from_zmp, pressure_point, settling
from motion.author.choreography import FOOT, GROUPS, Choreography, Knot
from motion.author.spline import minimum_jerk
from motion.author.stand import SIDES, StandPose

LIFT_SHARE = 0.15  # part of a step during which a foot next to the ground only rises or sinks
CONTACT_HEIGHT_M = 0.002
SETTLE_S = 0.5
CORRECTION_WIDTH_S = 0.03
_X, _Y, _Z = np.eye(3)


@dataclass(frozen=True, eq=False)
class AuthoredTargets:
    """N rows: times_s (N,), foot_pos_w (N,2,3), foot_quat_wxyz (N,2,4), contact (N,2), zmp_w and com_w (N,2),

    pelvis_height_m (N,), pelvis_quat_wxyz (N,4), waist_rad (N,3) yaw roll pitch, hand_m and elbow_m (N,2,3) in the
    torso frame.
    """

    times_s: np.ndarray
    foot_pos_w: np.ndarray
    foot_quat_wxyz: np.ndarray
    contact: np.ndarray
    zmp_w: np.ndarray
    com_w: np.ndarray
    pelvis_height_m: np.ndarray
    pelvis_quat_wxyz: np.ndarray
    waist_rad: np.ndarray
    hand_m: np.ndarray
    elbow_m: np.ndarray


def body_targets(choreography: Choreography, stand: StandPose) -> AuthoredTargets:
    """Targets of every frame. Raises InputError where a foot would slide or bear weight in the air."""
    dt = 1.0 / choreography.fps
    times = np.arange(round(choreography.key_times_s[-1] * choreography.fps) + 1) * dt
    tracks = {g: _group_track(choreography.knots[g], times) for g in GROUPS if not g.endswith("_foot")}
    feet = [_foot_track(choreography, f"{side}_foot", times) for side in SIDES]
    quats = np.stack([_quat(foot[:, 3], foot[:, 4], foot[:, 5]) for foot in feet], axis=1)
    positions = stand.foot_pos_w + np.stack([foot[:, :3] for foot in feet], axis=1)
    contact = np.stack([(foot[:, 2] < CONTACT_HEIGHT_M).astype(float) for foot in feet], axis=1)
    pelvis, balance = tracks["pelvis"], tracks["balance"]
    _check_load(choreography, times, balance[:, 0], contact)
    zmp = _pressure_point(balance, positions, quats, pelvis[:, 1], stand)
    arms = [tracks[f"{side}_arm"] for side in SIDES]
    elbows = [[stand.arms[s].elbow_at(row[:3], row[3]) for row in arm] for s, arm in zip(SIDES, arms, strict=True)]
    return AuthoredTargets(
        times_s=times,
        foot_pos_w=positions,
        foot_quat_wxyz=quats,
        contact=contact,
        zmp_w=zmp,
        com_w=com_from_zmp(zmp, stand.com_m[2] - pelvis[:, 0], dt, SETTLE_S),
        pelvis_height_m=stand.qpos[2] - pelvis[:, 0],
        pelvis_quat_wxyz=_quat(pelvis[:, 1], pelvis[:, 2], pelvis[:, 3]),
        waist_rad=tracks["torso"],
        hand_m=np.stack([arm[:, :3] for arm in arms], axis=1),
        elbow_m=np.stack([np.array(elbow) for elbow in elbows], axis=1),
    )


def corrected(
    targets: AuthoredTargets, stand: StandPose, qpos: np.ndarray, wanted_zmp_w: np.ndarray
) -> AuthoredTargets:
    """Targets whose CoM makes up for what swinging limbs did to the pressure point in their solution `qpos` (N,7+J)."""
    dt = targets.times_s[1] - targets.times_s[0]
    miss = gaussian_filter1d(pressure_point(stand.model, qpos, dt) - wanted_zmp_w, CORRECTION_WIDTH_S / dt, axis=0)
    zmp = targets.zmp_w - miss * settling(len(miss), dt, 2.0 * SETTLE_S)[:, None]
    height = stand.com_m[2] - stand.qpos[2] + targets.pelvis_height_m
    return replace(targets, zmp_w=zmp, com_w=com_from_zmp(zmp, height, dt, SETTLE_S))


def _quat(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """(N,4) of Rz(yaw) Ry(pitch) Rx(roll)."""
    turns = [quat_from_axis_angle(np.broadcast_to(a, (len(r), 3)), r) for a, r in ((_Z, yaw), (_Y, pitch), (_X, roll))]
    return quat_mul(quat_mul(turns[0], turns[1]), turns[2])


def _group_track(knots: list[Knot], times: np.ndarray) -> np.ndarray:
    """(N,C) of one group without steps."""
    knot_times = np.array([knot.at_s for knot in knots])
    values = np.array([knot.values for knot in knots])
    return np.stack([minimum_jerk(knot_times, column, times) for column in values.T], axis=1)


def _foot_track(choreography: Choreography, group: str, times: np.ndarray) -> np.ndarray:
    """(N,6) of one foot: where it stands it does not move; next to the ground it only rises or sinks."""
    knots, height = choreography.knots[group], FOOT.index("z_m")
    _check_foot(choreography, group)
    heights = [(knots[0].at_s, 0.0, True)]
    places = [(knots[0].at_s, knots[0].values)]
    for before, after in pairwise(knots):
        span = after.at_s - before.at_s
        down = before.values[height] == 0.0, after.values[height] == 0.0
        moves = after.arc_m > 0.0 or not all(down)
        if after.arc_m > 0.0:
            heights.append((before.at_s + 0.5 * span, after.arc_m, False))
        heights.append((after.at_s, after.values[height], down[1]))
        if moves and down[0]:
            places.append((before.at_s + LIFT_SHARE * span, before.values))
        if moves and down[1]:
            places.append((after.at_s - LIFT_SHARE * span, after.values))
        places.append((after.at_s, after.values))
    place_times = np.array([time for time, _ in places])
    track = np.stack([minimum_jerk(place_times, c, times) for c in np.array([v for _, v in places]).T], axis=1)
    at, values, rests = (np.array(column) for column in zip(*heights, strict=True))
    track[:, height] = minimum_jerk(at, values, times, rests.astype(bool))
    return track


def _check_foot(choreography: Choreography, group: str) -> None:
    knots, height = choreography.knots[group], FOOT.index("z_m")
    for knot in knots:
        where = f"{choreography.where(knot.key)}.{group}"
        if knot.values[height] < 0.0 or knot.arc_m < 0.0:
            raise InputError("below the ground", where=where, got=min(knot.values[height], knot.arc_m), expected="0 up")
        if knot.values[height] == 0.0 and any(knot.values[4:]):
            raise InputError("sole not flat", where=where, got=knot.values[4:], expected="pitch and roll 0 at z_m 0")
    for before, after in pairwise(knots):
        where = f"{choreography.where(after.key)}.{group}"
        on_ground = before.values[height] == 0.0 and after.values[height] == 0.0
        if on_ground and before.values != after.values and after.arc_m == 0.0:
            raise InputError("the foot would slide", where=where, got="no arc_m", expected="arc_m, the step's height")
        if not on_ground and after.arc_m > 0.0:
            raise InputError("not a step on the ground", where=where, got="arc_m", expected="z_m alone")


def _check_load(choreography: Choreography, times: np.ndarray, left: np.ndarray, contact: np.ndarray) -> None:
    share = np.stack([left, 1.0 - left], axis=1)
    bad = np.argwhere((contact == 0.0) & (share > 0.25))
    if len(bad):
        frame, foot = bad[0]
        raise InputError(
            f"the {SIDES[foot]} foot is in the air and bears weight",
            where=choreography.where(choreography.key_at(times[frame])),
            got=f"balance.left {left[frame]:.2f} at {times[frame]:.2f} s",
            expected="the weight on the other foot before, until after the step",
        )


def _pressure_point(
    balance: np.ndarray, foot_pos: np.ndarray, foot_quat: np.ndarray, pelvis_yaw: np.ndarray, stand: StandPose
) -> np.ndarray:
    """(N,2): `left` of the way from the right sole's middle to the left's, `forward_m` along the pelvis' heading.

    In the stand pose it is the CoM's own projection.
    """
    middle = np.concatenate([stand.sole_middle_m, np.zeros((2, 1))], axis=1)
    soles = (foot_pos + quat_rotate(foot_quat, np.broadcast_to(middle, foot_pos.shape)))[..., :2]
    left, forward = balance[:, :1], balance[:, 1:]
    offset = stand.com_m[:2] - (stand.foot_pos_w[:, :2] + stand.sole_middle_m).mean(axis=0)
    heading = np.stack([np.cos(pelvis_yaw), np.sin(pelvis_yaw)], axis=1)
    return left * soles[:, 0] + (1.0 - left) * soles[:, 1] + offset + forward * heading
