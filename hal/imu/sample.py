"""What an IMU measures, how it is mounted, and what every parser of its frames offers."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from core.errors import InputError
from core.rotations import quat_conjugate, quat_mul, quat_rotate

STANDARD_GRAVITY_M_S2 = 9.80665
NORM_TOLERANCE = 0.02
UNIT_TOLERANCE = 1e-3

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class ImuSample:
    """One measurement in SI units, in the frame of whoever made it.

    quat_wxyz: that frame to a world with z up, unit length. ang_vel: rad/s. acc: specific force in m/s^2, +9.81 along
    the axis that points up, at rest.
    """

    quat_wxyz: Quaternion
    ang_vel: Vector3
    acc: Vector3


class ImuParser(Protocol):
    """Bytes in, samples out, whatever is lost or altered between them. Counts what it refuses."""

    bad_frames: int

    def feed(self, data: bytes) -> list[ImuSample]:
        """The samples that are complete with these bytes, oldest first."""
        ...


class Mounting:
    """Turns samples from the IMU's frame into the base's.

    imu_to_base_wxyz: how the IMU's axes lie in the base. Raises InputError where it is not of unit length.
    """

    def __init__(self, imu_to_base_wxyz: Quaternion) -> None:
        norm = math.sqrt(sum(value * value for value in imu_to_base_wxyz))
        if not abs(norm - 1.0) <= UNIT_TOLERANCE:
            raise InputError(
                "mounting", where="imu", got=list(imu_to_base_wxyz), expected="a unit quaternion w, x, y, z"
            )
        self._quat = np.array(imu_to_base_wxyz) / norm

    def to_base(self, sample: ImuSample) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Orientation of the base (4,) wxyz, angular velocity (3,) rad/s and specific force (3,) m/s^2 in the base."""
        quat_wxyz = quat_mul(np.array(sample.quat_wxyz), quat_conjugate(self._quat))
        return (
            quat_wxyz,
            quat_rotate(self._quat, np.array(sample.ang_vel)),
            quat_rotate(self._quat, np.array(sample.acc)),
        )

    def to_imu(self, quat_wxyz: np.ndarray, ang_vel_b: np.ndarray, acc_b: np.ndarray) -> ImuSample:
        """What an IMU so mounted measures: the inverse of `to_base`."""
        inverse = quat_conjugate(self._quat)
        w, x, y, z = quat_mul(quat_wxyz, self._quat).tolist()
        (gx, gy, gz), (ax, ay, az) = quat_rotate(inverse, ang_vel_b).tolist(), quat_rotate(inverse, acc_b).tolist()
        return ImuSample((w, x, y, z), (gx, gy, gz), (ax, ay, az))


def unit_quaternion(w: float, x: float, y: float, z: float) -> Quaternion | None:
    """The quaternion at unit length; None where its length is not 1 within 2 %: then it is no orientation."""
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= NORM_TOLERANCE:
        return None
    return w / norm, x / norm, y / norm, z / norm
