"""Height of a human motion: feet in contact brought to the ground (Eq. 3), smoothly."""

from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from core.errors import InputError
from motion.human.motion import HumanMotion
from motion.settings import read_section

_MM = 1000.0


@dataclass(frozen=True)
class CorrectSettings:
    """Section `correct` of configs/motion/process.yaml; see there."""

    smoothing_s: float
    max_residual_m: float


def correct_height(m: HumanMotion, contact: np.ndarray, settings: CorrectSettings | None = None) -> HumanMotion:
    """`m` moved up and down so that its lowest sole is on the ground wherever a foot is in contact (contact (N,2)).

    In between, in the air, the correction goes linearly from one contact to the next, so that a flight stays a flight.
    Without any contact the motion stays as it is. A note says what was corrected. Raises InputError when `contact` does
    not fit the motion.
    """
    if contact.shape != (m.num_frames, 2):
        raise InputError("wrong shape", where="contact", got=contact.shape, expected=(m.num_frames, 2))
    settings = settings or read_section(CorrectSettings, "correct")
    standing = contact.max(axis=1) > 0.5
    if not standing.any():
        return replace(m, notes=(*m.notes, "No foot is ever in contact: the height is as recorded."))
    offset = height_offset_m(m.sole_w[..., 2].min(axis=(1, 2)), standing, m.fps, settings)
    note = f"The height was corrected by {_MM * -offset.max():+.0f} to {_MM * -offset.min():+.0f} mm."
    drop = offset[:, None] * np.array([0.0, 0.0, 1.0])
    return replace(m, pos_w=m.pos_w - drop[:, None], sole_w=m.sole_w - drop[:, None, None], notes=(*m.notes, note))


def height_offset_m(lowest_m: np.ndarray, standing: np.ndarray, fps: float, settings: CorrectSettings) -> np.ndarray:
    """Eq. 3's height (N,) to subtract, from the height of the lowest sole point (N,) and where a foot stands (N,).

    Smoothed by an exponential moving average, forwards and backwards so that it lags nothing; it ends within
    max_residual_m of Eq. 3 where a foot stands, linear between, and never leaves a sole deeper than that elsewhere.
    """
    frames = np.arange(len(lowest_m))

    def carried(heights: np.ndarray) -> np.ndarray:
        return np.interp(frames, frames[standing], heights[standing])

    smooth = _moving_average(carried(lowest_m), 1.0 - np.exp(-1.0 / (fps * max(settings.smoothing_s, 1e-9))))
    near = np.clip(smooth, lowest_m - settings.max_residual_m, lowest_m + settings.max_residual_m)
    return np.where(standing, near, np.minimum(carried(near), lowest_m + settings.max_residual_m))


def _moving_average(values: np.ndarray, weight: float) -> np.ndarray:
    """Exponential moving average with `weight` of the newest, there and back; it begins at the ends' own values."""
    for _ in range(2):
        values = np.array(list(accumulate(values, lambda mean, value: (1.0 - weight) * mean + weight * value)))[::-1]
    return values
