"""How a motion moves as a whole: what a stick would have to say for it."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from core.rotations import yaw_of
from motion.reference import Reference

SMOOTHING_S = 0.3  # standard deviation; half a walking step, so that neither sway nor the swing of the hips is left

AXES = ("forward", "left", "turn")  # m/s, m/s, rad/s
STEERED_ON = "steered_on"  # key of an actor's provenance
USUAL_PERCENT = (1.0, 99.0)  # of all ticks: what is rarer hardly was trained


def with_steering(reference: Reference) -> Reference:
    """The reference with its steering (K+1, 4)."""
    return replace(reference, steering=steering_of(reference))


def steering_of(reference: Reference) -> np.ndarray:
    """Smooth speed forward and to the left, m/s, turn, rad/s, and heading, rad, at every tick (K+1, 4).

    The heading is the root's, without steps of a whole turn; the speeds are in its frame.
    """
    from scipy.ndimage import gaussian_filter1d  # see motion.inverse_dynamics

    sigma = SMOOTHING_S / reference.dt_s
    heading = gaussian_filter1d(np.unwrap(yaw_of(reference.root_quat_wxyz)), sigma, mode="nearest")
    velocity = gaussian_filter1d(reference.root_lin_vel_w[:, :2], sigma, axis=0, mode="nearest")
    cosine, sine = np.cos(heading), np.sin(heading)
    forward = cosine * velocity[:, 0] + sine * velocity[:, 1]
    left = -sine * velocity[:, 0] + cosine * velocity[:, 1]
    return np.column_stack([forward, left, np.gradient(heading, reference.dt_s), heading])


def steering_range(references: Iterable[Reference]) -> dict[str, tuple[float, float]]:
    """The usual speeds and turns of some motions, one or more: from the 1st to the 99th percentile of all ticks."""
    rows = np.concatenate([steering_of(reference)[:, : len(AXES)] for reference in references])
    low, high = np.percentile(rows, USUAL_PERCENT, axis=0)
    return {name: (float(low[axis]), float(high[axis])) for axis, name in enumerate(AXES)}


def steering_range_from(provenance: Mapping[str, Any]) -> Mapping[str, tuple[float, float]] | None:
    """What an actor's file says of the speeds it was trained on, or None where it says nothing that can be read."""
    try:
        said = {name: (float(provenance[STEERED_ON][name][0]), float(provenance[STEERED_ON][name][1])) for name in AXES}
    except (KeyError, IndexError, TypeError, ValueError, OverflowError):
        return None
    readable = all(math.isfinite(low) and low <= high < math.inf for low, high in said.values())
    return said if readable else None
