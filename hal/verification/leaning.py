"""Whether acceleration, orientation and angular velocity tell of the lean that was asked for."""

import math
from collections.abc import Sequence

import numpy as np

from core.rotations import projected_gravity
from hal.contract.types import RobotState
from hal.verification.options import VerifyOptions

# The rotation of the base, in its own axes: forwards about its left, to the left about its back.
AXES = {"forwards": np.array([0.0, 1.0]), "left": np.array([-1.0, 0.0])}


def up_by_acceleration(states: Sequence[RobotState]) -> np.ndarray:
    """(3,) where up is in the base, of unit length: at rest the specific force points there."""
    force_b = np.mean([state.imu_acc_b for state in states], axis=0)
    return force_b / max(float(np.linalg.norm(force_b)), 1e-9)


def up_by_orientation(states: Sequence[RobotState]) -> np.ndarray:
    """(3,) likewise by the quaternion."""
    up_b = -np.mean([projected_gravity(state.imu_quat_wxyz) for state in states], axis=0)
    return up_b / max(float(np.linalg.norm(up_b)), 1e-9)


def upright_problem(states: Sequence[RobotState], options: VerifyOptions) -> str | None:
    """Of a base that stands upright, as anybody can see."""
    for what, up_b in (("acceleration", up_by_acceleration(states)), ("orientation", up_by_orientation(states))):
        tilt_rad = math.acos(min(1.0, max(-1.0, float(up_b[2]))))
        if tilt_rad > options.upright_rad:
            return f"imu: by its {what} the upright base leans by {tilt_rad:.2f} rad: its mounting is not the file's"
    return None


def lean_problem(
    direction: str,
    before: Sequence[RobotState],
    during: Sequence[RobotState],
    after: Sequence[RobotState],
    options: VerifyOptions,
) -> str | None:
    """What is wrong with the IMU, None where nothing is. during: the states between two times of rest."""
    acc = _turned(up_by_acceleration(before), up_by_acceleration(after))
    quat = _turned(up_by_orientation(before), up_by_orientation(after))
    gyro = _by_gyro(during)
    if (off_rad := _angle(acc, AXES[direction])) > options.turned_rad:
        return (
            f"imu: leaning {direction} looks turned by {off_rad:.2f} rad about the vertical: "
            "its mounting is not the file's (imu_to_base_wxyz)"
        )
    for what, seen in (("orientation", quat), ("gyro", gyro)):
        size = float(np.linalg.norm(seen) / np.linalg.norm(acc))
        if abs(size - 1.0) > options.gyro_share or _angle(seen, acc) > options.turned_rad:
            return (
                f"imu: leaning {direction}, its {what} tells of {size:.2f} times what its acceleration tells of, "
                f"{_angle(seen, acc):.2f} rad apart: wrong units, axes or signs"
            )
    return None


def lean_rad(before: Sequence[RobotState], now: RobotState) -> float:
    """How far the base has turned, by whichever of the two says more."""
    ways = (up_by_acceleration, up_by_orientation)
    return max(_angle(up(before), up([now])) for up in ways)


def _by_gyro(states: Sequence[RobotState]) -> np.ndarray:
    """(2,) how far the base has turned about its x and y, by integration.

    No bias is taken off: on its gantry a robot is never quite at rest, and a bias that shows here is too large to use.
    """
    rates = np.array([state.imu_ang_vel_b[:2] for state in states])
    steps_s = np.diff([state.time_s - state.imu_age_s for state in states])
    return (0.5 * (rates[1:] + rates[:-1]) * steps_s[:, None]).sum(axis=0)


def _turned(up_before: np.ndarray, up_after: np.ndarray) -> np.ndarray:
    """(2,) the rotation's parts about the base's x and y."""
    return np.cross(up_after, up_before)[:2]


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    cosine = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-9)
    return math.acos(min(1.0, max(-1.0, cosine)))
