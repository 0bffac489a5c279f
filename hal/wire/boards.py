"""What the devices last said, from the threads of the wire process to the loop, with the time of each value."""

import json
import math
import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hal.wire.ring import Ring

TEXT_BYTES = 8192
STATISTICS_BYTES = 16384
ROWS = 5
POS, VEL, TORQUE, TEMPERATURE, STAMP = range(ROWS)
IMU_VALUES = 11
STICKS, CHARGE, SUPPLY, SUPPLY_HIGH, REMOTE, ENERGISED = slice(-9, -5), -5, -4, -3, -2, -1
NUM_STICKS, EXTRA = 4, 9  # of a remote; numbers after the IMU's
Index = np.ndarray | list[int] | slice | int
Value = np.ndarray | float


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One consistent copy. Stamps are on the monotonic clock, -inf where nothing has been heard yet.

    temperature_c: (J,), NaN where unknown. remote_stamp_s: when the remote was last heard. charge, supply,
    supply_high, energised: see RobotState. remote_sticks (4,): left x, y, right x, y, from -1 to 1, right and up
    positive.
    """

    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    joint_torque_nm: np.ndarray
    temperature_c: np.ndarray
    joint_stamp_s: np.ndarray
    imu_quat_wxyz: np.ndarray
    imu_ang_vel_b: np.ndarray
    imu_acc_b: np.ndarray
    imu_stamp_s: float
    charge: float
    supply: float
    supply_high: float
    remote_stamp_s: float
    remote_sticks: np.ndarray
    energised: bool


class StateBoard:
    """Written by any thread of the wire process, read by the loop. Joints are in the robot's order, values are
    joint-side (after the joint map), SI units, and exactly what the device said, NaN included."""

    def __init__(self, buffer: memoryview, num_joints: int) -> None:
        self.num_joints = num_joints
        numbers = Ring.size(_number_bytes(num_joints))
        self._numbers = Ring(buffer[:numbers], _number_bytes(num_joints))
        texts = numbers + Ring.size(TEXT_BYTES)
        self._texts = Ring(buffer[numbers:texts], TEXT_BYTES)
        self._statistics = Ring(buffer[texts:], STATISTICS_BYTES)
        self._values = np.full(ROWS * num_joints + IMU_VALUES + EXTRA, np.nan)
        self._joints = self._values[: ROWS * num_joints].reshape(ROWS, num_joints)
        self._imu = self._values[ROWS * num_joints : -EXTRA]
        self._joints[STAMP] = self._imu[-1] = self._values[REMOTE] = -np.inf
        self._values[ENERGISED], self._values[STICKS] = 0.0, 0.0
        self._lock = threading.Lock()
        self._faults: set[str] = set()
        self._buttons: tuple[str, ...] = ()
        self._stats: dict[str, float] = {}
        self._supplies: dict[str, tuple[float, float]] = {}

    @staticmethod
    def size(num_joints: int) -> int:
        """Bytes of shared memory."""
        return sum(Ring.size(capacity) for capacity in (_number_bytes(num_joints), TEXT_BYTES, STATISTICS_BYTES))

    def joints(
        self,
        index: Index,
        pos_rad: Value,
        vel_rad_s: Value,
        torque_nm: Value,
        temperature_c: Value,
        stamp_s: Value,
    ) -> None:
        """Values of some joints (robot order), measured at stamp_s. temperature_c: NaN without a sensor."""
        with self._lock:
            self._joints[POS, index], self._joints[VEL, index] = pos_rad, vel_rad_s
            self._joints[TORQUE, index], self._joints[TEMPERATURE, index] = torque_nm, temperature_c
            self._joints[STAMP, index] = stamp_s
            self._numbers.publish(self._values.tobytes())

    def imu(self, quat_wxyz: np.ndarray, ang_vel_b: np.ndarray, acc_b: np.ndarray, stamp_s: float) -> None:
        """Orientation (4,), angular velocity (3,) in rad/s and specific force (3,) in m/s^2, measured at stamp_s."""
        with self._lock:
            self._imu[:4], self._imu[4:7], self._imu[7:10] = quat_wxyz, ang_vel_b, acc_b
            self._imu[10] = stamp_s
            self._numbers.publish(self._values.tobytes())

    def remote(self, buttons: Collection[str], stamp_s: float, sticks: Sequence[float] = (0.0,) * NUM_STICKS) -> None:
        """The buttons of a wireless remote that are pressed and its sticks, see Snapshot, heard at stamp_s."""
        with self._lock:
            self._values[REMOTE], self._values[STICKS] = stamp_s, sticks
            self._numbers.publish(self._values.tobytes())
            if (pressed := tuple(sorted(buttons))) != self._buttons:
                self._buttons = pressed
                self._publish_texts()

    def charge(self, share: float) -> None:
        """What is left in the battery, 0 to 1. Shown with the next values of joints or IMU, as is `supply`."""
        with self._lock:
            self._values[CHARGE] = share
            self._stats["battery charge %"] = 100.0 * share

    def supply(self, source: str, lowest: float, highest: float) -> None:
        """Supply voltages of one bus or port over the nominal one; the lowest and the highest of all are shown."""
        with self._lock:
            self._supplies[source] = lowest, highest
            lows, highs = zip(*self._supplies.values())
            self._values[SUPPLY], self._values[SUPPLY_HIGH] = min(lows), max(highs)
            self._stats["battery supply %"] = 100.0 * min(lows)
            self._stats["battery highest supply %"] = 100.0 * max(highs)

    def energised(self, obeying: bool) -> None:
        """Whether the devices obey what is sent, from now on."""
        with self._lock:
            self._values[ENERGISED] = obeying
            self._numbers.publish(self._values.tobytes())

    def fault(self, name: str, present: bool) -> None:
        """A device's fault begins or is over. name: as `RobotState.faults` shows it, e.g. "motor_fault:JOINT: reason".

        Cheap where nothing changes. A driver that latches keeps it until `acknowledge()`.
        """
        if (name in self._faults) == present:
            return
        with self._lock:
            self._faults = self._faults | {name} if present else self._faults - {name}
            self._publish_texts()

    def stats(self, name: str, value: float) -> None:
        """A figure for logs and for the report at the end, e.g. a counter of corrupt frames."""
        with self._lock:
            self._stats[name] = value

    def all_stats(self) -> dict[str, float]:
        """Every figure given so far; in the wire process only."""
        with self._lock:
            return dict(self._stats)

    def publish_statistics(self, content: Mapping[str, Any]) -> None:
        """Show the loop counters; what does not fit is left out."""
        record = json.dumps(content, default=float).encode()
        if len(record) <= STATISTICS_BYTES:
            self._statistics.publish(record)

    def statistics(self) -> dict[str, Any]:
        """Counters as last published; empty before."""
        latest = self._statistics.latest()
        return {} if latest is None else json.loads(latest[1])

    def snapshot(self) -> Snapshot | None:
        """The newest values; None where nothing has been heard at all."""
        latest = self._numbers.latest()
        if latest is None:
            return None
        values = np.frombuffer(latest[1], dtype=np.float64)
        joints = values[: ROWS * self.num_joints].reshape(ROWS, self.num_joints)
        imu = values[ROWS * self.num_joints : -EXTRA]
        return Snapshot(
            joint_pos_rad=joints[POS],
            joint_vel_rad_s=joints[VEL],
            joint_torque_nm=joints[TORQUE],
            temperature_c=joints[TEMPERATURE],
            joint_stamp_s=joints[STAMP],
            imu_quat_wxyz=imu[:4],
            imu_ang_vel_b=imu[4:7],
            imu_acc_b=imu[7:10],
            imu_stamp_s=float(imu[10]),
            charge=float(values[CHARGE]),
            supply=float(values[SUPPLY]),
            supply_high=float(values[SUPPLY_HIGH]),
            remote_stamp_s=float(values[REMOTE]),
            remote_sticks=values[STICKS],
            energised=bool(values[ENERGISED]),
        )

    def texts(self) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
        """Faults and pressed buttons, as last published; None where they cannot be had whole just now."""
        latest = self._texts.latest()
        if latest is None:
            return None if self._texts.serial else ((), ())
        content = json.loads(latest[1])
        return tuple(content["faults"]), tuple(content["buttons"])

    @property
    def texts_serial(self) -> int:
        """Changes whenever `texts` does."""
        return self._texts.serial

    def _publish_texts(self) -> None:
        """Faults that no longer fit are counted: the loop stops for the first one as well as for the last."""
        names = sorted(self._faults)
        for kept in range(len(names), -1, -1):
            left_out = [f"{len(names) - kept} more faults"] if kept < len(names) else []
            record = json.dumps({"faults": [*names[:kept], *left_out], "buttons": self._buttons}).encode()
            if len(record) <= TEXT_BYTES:
                self._texts.publish(record)
                return


def is_complete(snapshot: Snapshot | None) -> bool:
    """Whether every joint and the IMU have been heard."""
    if snapshot is None:
        return False
    return math.isfinite(snapshot.imu_stamp_s) and bool(np.isfinite(snapshot.joint_stamp_s).all())


def missing(snapshot: Snapshot | None, joint_names: Sequence[str]) -> str:
    """What has not been heard yet, in words."""
    if snapshot is None:
        return "no state has arrived yet"
    names = [name for name, s in zip(joint_names, snapshot.joint_stamp_s) if not math.isfinite(s)]
    names += [] if math.isfinite(snapshot.imu_stamp_s) else ["the IMU"]
    return f"nothing heard yet of {', '.join(names)}"


def _number_bytes(num_joints: int) -> int:
    return 8 * (ROWS * num_joints + IMU_VALUES + EXTRA)
