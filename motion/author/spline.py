"""Minimum-jerk curves through knots that rest where two knots in a row are equal."""

from itertools import pairwise

import numpy as np
from scipy.interpolate import make_interp_spline

_EQUAL = 1e-12


def minimum_jerk(
    knot_times_s: np.ndarray, knot_values: np.ndarray, times_s: np.ndarray, rests: np.ndarray | None = None
) -> np.ndarray:
    """Values (N,) at `times_s` (N,) of the curve through the knots (K,), clamped to its ends.

    The curve rests (no velocity, no acceleration) at its ends, wherever neighbouring knots have the same value and
    where `rests` (K,) says so; between rests it is the quintic spline that minimises the squared jerk: C2 everywhere.
    """
    times, values = np.asarray(knot_times_s, float), np.asarray(knot_values, float)
    query = np.clip(times_s, times[0], times[-1])
    equal = np.abs(np.diff(values)) < _EQUAL
    resting = np.concatenate(([True], equal[:-1] | equal[1:], [True]))
    if rests is not None:
        resting |= rests
    result = np.empty_like(query)
    stops = np.flatnonzero(resting)
    for first, last in pairwise(stops):
        inside = (query >= times[first]) & (query <= times[last])
        if last == first + 1 and equal[first]:
            result[inside] = values[first]
            continue
        piece = slice(first, last + 1)
        at_rest = [(1, 0.0), (2, 0.0)]
        result[inside] = make_interp_spline(times[piece], values[piece], k=5, bc_type=(at_rest, at_rest))(query[inside])
    return result
