"""Which way is down, by gyroscope and measured gravity together: a complementary filter."""

from __future__ import annotations

from typing import Any

from core.rotations import array_module, cross, normalize

Array = Any  # np.ndarray or torch.Tensor

TIME_CONSTANT_S = 0.5  # of what the gyroscope is believed for


def filtered_gravity(before: Array, gravity_b: Array, ang_vel_b: Array, ticks: Array, control_period_s: float) -> Array:
    """Direction of gravity in the base frame (..., 3), which white noise hardly reaches.

    The last value is turned by the gyroscope, then drawn towards the measured one, as in Mahony, Hamel and Pflimlin,
    "Nonlinear Complementary Filters on the Special Orthogonal Group" (2008), Eq. 32. The first ticks count alike, so
    that the first value is what is measured.

    Args:
        before: (..., 3) of the tick before.
        gravity_b: (..., 3) measured direction.
        ang_vel_b: (..., 3) measured angular velocity, rad/s.
        ticks: (...) since the filter began; at 0 ``before`` may be anything, NaN too.
        control_period_s: of a tick.
    """
    known = array_module(gravity_b).where((ticks > 0)[..., None], before, gravity_b)
    turned = known + control_period_s * cross(known, ang_vel_b)
    share = (1.0 / (1.0 + ticks)).clip(min=control_period_s / TIME_CONSTANT_S)[..., None]
    return normalize(turned + share * (gravity_b - turned))
