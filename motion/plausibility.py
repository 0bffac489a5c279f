"""Rules that a motion breaks when nobody could perform it, each with what it found (Eq. 1 is the first)."""

from dataclasses import dataclass

import numpy as np

from motion.feet import CONTACT_RULE_FPS, sole_normal_w
from motion.physics_checks import (
    MAX_UNSTABLE_FRAMES,
    NEAR_GROUND_M,
    STABLE_DISTANCE_M,
    is_stable,
    phases,
)
from motion.track import STEP_S, SupportTrack, difference, second_difference, turn_rate

GRAVITY_M_S2 = 9.81
_FREE_FALL = 0.5  # body weights: in the air a motion may be off from free fall by so much
_DIRECTIONS = 72  # of the lines that bound the hull of the soles; a point 0.1 m outside is off by 0.1 mm at most


@dataclass(frozen=True)
class FilterSettings:
    """Section `filter` of configs/motion/process.yaml; see there."""

    support_margin_m: float
    max_flight_s: float
    max_sink_m: float
    standing_speed_m_s: float
    max_lean_rad: float
    max_root_acceleration_m_s2: float
    max_root_turn_rad_s: float
    max_point_speed_m_s: float
    max_joint_speed_factor: float
    force_window_s: float
    friction: float
    max_force_body_weights: float
    max_impossible_share: float


@dataclass(frozen=True, eq=False)
class Finding:
    """What one rule found: its name, whether the motion keeps it, the frames (K,) that do not, the figure that decides
    and its limit, and in words what is wrong (empty where nothing is)."""

    rule: str
    passed: bool
    frames: np.ndarray
    value: float
    limit: float
    reason: str


def balance(track: SupportTrack, distance_m: np.ndarray, settings: FilterSettings) -> Finding:
    """Eq. 1 and its two conditions on `distance_m` (N,); frames whose centre of mass is above what bears are stable."""
    supported = outside_support_m(track.com_w[:, :2], track.bearing_w) < -settings.support_margin_m
    unstable = (distance_m >= STABLE_DISTANCE_M) & ~supported
    passed = is_stable(np.where(unstable, np.inf, 0.0), track.fps)
    length, first = _longest(unstable)
    value = (length + 1 if length else 0) * CONTACT_RULE_FPS / track.fps  # from one stable frame to the next
    ends = [i for i in (0, -1) if unstable[i]]
    if ends:
        where, far = "first" if ends[0] == 0 else "last", distance_m[ends[0]]
        beside = f"{far:.2f} m beside the pressure on the ground"
        place = beside if np.isfinite(far) else "above nothing that touches the ground"
        reason = f"out of balance: in the {where} frame the centre of mass is {place}"
    else:
        reason = f"out of balance: from {first / track.fps:.1f} s it is {value:.0f} frames (at 30 fps) to a stable one"
    reason += f" (Eq. 1: within {STABLE_DISTANCE_M:g} m, from one such frame to the next under {MAX_UNSTABLE_FRAMES})"
    return Finding("balance", passed, np.flatnonzero(unstable), value, MAX_UNSTABLE_FRAMES, "" if passed else reason)


def flight(track: SupportTrack, settings: FilterSettings) -> Finding:
    """No time without anything near the ground that is longer than a jump."""
    airborne = _airborne(track)
    length, first = _longest(airborne)
    value, limit = length / track.fps, settings.max_flight_s
    reason = (
        f"floating: from {first / track.fps:.1f} s nothing is within {100 * NEAR_GROUND_M:g} cm of the ground for "
        f"{value:.1f} s, longer than any jump ({limit:g} s)"
    )
    return _finding("flight", value, limit, airborne, reason)


def sinking(track: SupportTrack, settings: FilterSettings) -> Finding:
    """No sole deep below the ground."""
    depth = -track.sole_w[..., 2].min(axis=(1, 2))
    value, limit = max(0.0, float(depth.max())), settings.max_sink_m
    reason = f"sunk: at {_at(depth, track.fps)} a sole is {value:.2f} m below the ground (at most {limit:g})"
    return _finding("sinking", value, limit, depth > limit, reason)


def tilt(track: SupportTrack, settings: FilterSettings) -> Finding:
    """Among the feet at rest, the flattest quarter lies flat: otherwise the world is not level."""
    lean = sole_lean_rad(track.sole_w)
    speed = np.linalg.norm(difference(track.sole_w.mean(axis=2), track.fps, STEP_S), axis=-1)
    resting = speed < settings.standing_speed_m_s
    value = float(np.quantile(lean[resting], 0.25)) if resting.any() else 0.0
    limit = settings.max_lean_rad
    leaning = (resting & (lean > limit)).any(axis=1) & (value > limit)
    reason = (
        f"tilted: three quarters of the feet that rest lean by {np.rad2deg(value):.0f} degrees or more (at most "
        f"{np.rad2deg(limit):.0f}): the ground is not level, or not at height 0"
    )
    return _finding("tilt", value, limit, leaning, reason)


def jump(track: SupportTrack, settings: FilterSettings) -> Finding:
    """The root moves without leaps."""
    acceleration = np.linalg.norm(second_difference(track.root_pos_w, track.fps, STEP_S), axis=-1)
    value, limit = float(acceleration.max()), settings.max_root_acceleration_m_s2
    reason = f"leaps: at {_at(acceleration, track.fps)} the root accelerates at {value:.0f} m/s² (at most {limit:g})"
    return _finding("jump", value, limit, acceleration > limit, reason)


def spin(track: SupportTrack, settings: FilterSettings) -> Finding:
    """The root turns without leaps."""
    rate = turn_rate(track.root_quat_wxyz, track.fps)
    value, limit = float(rate.max()), settings.max_root_turn_rad_s
    reason = f"turns over: at {_at(rate, track.fps)} the root turns at {value:.0f} rad/s (at most {limit:g})"
    return _finding("spin", value, limit, rate > limit, reason)


def speed(track: SupportTrack, settings: FilterSettings) -> Finding:
    """No part is faster than any human's, or than the robot's joints by far."""
    share = track.speed / track.speed_limit
    frame, part = np.unravel_index(int(share.argmax()), share.shape)
    value, limit = float(track.speed[frame, part]), float(track.speed_limit[part])
    reason = (
        f"too fast: at {frame / track.fps:.1f} s {track.speed_names[part]} moves at {value:.1f} {track.speed_unit} "
        f"(at most {limit:.3g})"
    )
    return _finding("speed", value, limit, (share > 1.0).any(axis=1), reason)


def force(track: SupportTrack, settings: FilterSettings) -> Finding:
    """The ground can give the force that the centre of mass asks for: upwards, within friction, a few body weights."""
    acceleration = second_difference(track.com_w, track.fps, settings.force_window_s)
    wanted = acceleration / GRAVITY_M_S2 + np.array([0.0, 0.0, 1.0])
    size = np.linalg.norm(wanted, axis=-1)
    slips = np.linalg.norm(wanted[:, :2], axis=-1) > settings.friction * np.maximum(wanted[:, 2], 0.0)
    impossible = slips | (wanted[:, 2] < 0.0) | (size > settings.max_force_body_weights)
    impossible &= ~(_airborne(track) & (size < _FREE_FALL))
    value, limit = float(impossible.mean()), settings.max_impossible_share
    reason = (
        f"too violent: in {100 * value:.0f} % of the frames (at most {100 * limit:g}) the ground would have to pull, "
        f"or to give friction over {settings.friction:g}, or to push with {settings.max_force_body_weights:g} body "
        "weights or more; is it played too fast?"
    )
    return _finding("force", value, limit, impossible, reason)


def outside_support_m(point_xy: np.ndarray, bearing_w: np.ndarray) -> np.ndarray:
    """How far (N,) each point (N,2) is outside the hull of those of the points (N,P,3) that are near the ground.

    Negative inside, the distance to the nearest edge; infinite without such points.
    """
    angle = np.arange(_DIRECTIONS) * (2.0 * np.pi / _DIRECTIONS)
    directions = np.stack([np.cos(angle), np.sin(angle)])
    near = bearing_w[..., 2] <= NEAR_GROUND_M
    reach = np.full((len(bearing_w), _DIRECTIONS), -np.inf)
    for point in np.flatnonzero(near.any(axis=0)):  # few of a body's points ever bear
        frames = near[:, point]
        reach[frames] = np.maximum(reach[frames], bearing_w[frames, point, :2] @ directions)
    return (point_xy @ directions - reach).max(axis=1)


def sole_lean_rad(sole_w: np.ndarray) -> np.ndarray:
    """Angle (N,2) between each sole (N,2,S,3) and the ground."""
    return np.arccos(np.clip(sole_normal_w(sole_w)[..., 2], 0.0, 1.0))


def _airborne(track: SupportTrack) -> np.ndarray:
    """(N,) where nothing is near the ground."""
    return track.bearing_w[..., 2].min(axis=1) > NEAR_GROUND_M


def _finding(rule: str, value: float, limit: float, broken: np.ndarray, reason: str) -> Finding:
    passed = value <= limit
    return Finding(rule, passed, np.flatnonzero(broken), value, limit, "" if passed else reason)


def _longest(active: np.ndarray) -> tuple[int, int]:
    """Length and first frame of the longest run of True in a mask (N,); 0, 0 without one."""
    return max(((end - first, first) for first, end in phases(active)), default=(0, 0))


def _at(values: np.ndarray, fps: float) -> str:
    """The time of the largest of `values` (N,)."""
    return f"{values.argmax() / fps:.1f} s"
