"""How a motion moves as a whole: what a stick would have to say for it."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from core.rotations import yaw_of
from motion.reference import Reference

SMOOTHING_S = 0.3  # standard deviation; half a walking step, so that neither sway nor the swing of the hips is left


def with_steering(reference: Reference) -> Reference:
    """The reference with its steering (K+1, 4)."""
    return replace(reference, steering=steering_of(reference))


def steering_of(reference: Reference) -> np.ndarray:
    """Smooth speed forward and to the left, m/s, turn, rad/s, and heading, rad, at every tick (K+1, 4).

    The heading is the root's, without steps of a whole turn; the speeds are in its frame.
    """
    sigma = SMOOTHING_S / reference.dt_s
    heading = gaussian_filter1d(np.unwrap(yaw_of(reference.root_quat_wxyz)), sigma, mode="nearest")
    velocity = gaussian_filter1d(reference.root_lin_vel_w[:, :2], sigma, axis=0, mode="nearest")
    cosine, sine = np.cos(heading), np.sin(heading)
    forward = cosine * velocity[:, 0] + sine * velocity[:, 1]
    left = -sine * velocity[:, 0] + cosine * velocity[:, 1]
    return np.column_stack([forward, left, np.gradient(heading, reference.dt_s), heading])
