"""The device side of a serial IMU: its frames at its rate, on a pseudo-terminal."""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from core import robot_time as time
from core.config import config_file, load_options
from core.rotations import quat_from_axis_angle, quat_mul
from hal.emulator.device import DeviceSide, Worker
from hal.emulator.faults import DelayLine, FaultKind, Faults
from hal.emulator.pty import Terminal
from hal.emulator.robot import EmulatedRobot
from hal.imu.options import PROTOCOLS, ImuOptions
from hal.imu.sample import Mounting

KEY = "imu"
FORWARD = np.array([0.0, 1.0, 0.0])
IMU_FAULTS: Mapping[str, FaultKind] = {
    "imu_units": FaultKind("the accelerometer's scale; value: factor", 1.0 / 9.81),
    "imu_tilt": FaultKind("the orientation leans forward; value: rad", 0.3),
}


def disturbed(faults: Faults, quat_wxyz: np.ndarray, acc_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What an IMU with these faults says of an orientation (4,) wxyz and a specific force (3,) m/s^2."""
    if (lean_rad := faults.value("imu_tilt", KEY)) is not None:
        quat_wxyz = quat_mul(quat_wxyz, quat_from_axis_angle(FORWARD, np.array(lean_rad)))
    scale = faults.value("imu_units", KEY)
    return quat_wxyz, acc_b if scale is None else acc_b * scale


class ImuLine:
    """One emulated IMU. It listens on `path` after `start`. Its faults go by the key `imu`."""

    def __init__(self, robot: EmulatedRobot, faults: Faults, options: ImuOptions) -> None:
        self._robot, self._faults, self._options = robot, faults, options
        self._encode = PROTOCOLS[options.protocol].encode
        self._mounting = Mounting(options.imu_to_base_wxyz)
        self._line: DelayLine[bytes] = DelayLine()
        self._terminal: Terminal | None = None
        self._worker: Worker | None = None
        self.sent = 0

    @property
    def path(self) -> str:
        """Where the host connects; empty before `start`."""
        return "" if self._terminal is None else self._terminal.path

    @property
    def failure(self) -> Exception | None:
        """What ended its thread, if anything did."""
        return None if self._worker is None else self._worker.failure

    def start(self) -> None:
        """Begin to send."""
        self._terminal = Terminal(KEY)
        self._worker = Worker(KEY, self._round, 1.0 / self._options.rate_hz)
        self._worker.start()

    def stop(self) -> None:
        """May be repeated."""
        if self._worker is not None and self._terminal is not None:
            self._worker.stop()
            self._terminal.close()

    def _round(self, now_s: float) -> None:
        assert self._terminal is not None
        if self._faults.active("reconnect", KEY):
            self._terminal.unplug()
            return
        self._terminal.plug_in()
        fate = self._faults.fate(KEY)
        if not fate.lost:
            frame = self._frame()
            if fate.corrupted:
                frame = self._faults.corrupted(frame)
            self._line.put(now_s + self._options.wire_time_s + fate.delay_s, frame)
        time.sleep(max(0.0, min(self._line.due_s - time.monotonic(), self._options.wire_time_s)))
        for frame in self._line.arrived(time.monotonic()):
            self._terminal.write(frame)
            self.sent += 1

    def _frame(self) -> bytes:
        measured = self._robot.measure()
        quat_wxyz, acc_b = disturbed(self._faults, measured.imu_quat_wxyz, measured.imu_acc_b)
        return self._encode(self._mounting.to_imu(quat_wxyz, measured.imu_ang_vel_b, acc_b))


class ImuDevice(DeviceSide):
    """An IMU alone, for whoever tries its reader."""

    default_config = "imu_hipnuc"
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = IMU_FAULTS

    def __init__(self, robot: EmulatedRobot, faults: Faults, config: str) -> None:
        self._line = ImuLine(robot, faults, load_options(ImuOptions, config_file("hal", config)))
        self.lines = (self._line,)

    @property
    def endpoints(self) -> Mapping[str, str]:
        """See DeviceSide."""
        return {KEY: self._line.path}

    @property
    def fault_keys(self) -> tuple[str, ...]:
        """See DeviceSide."""
        return (KEY,)

    def reset(self) -> None:
        """See DeviceSide. An IMU forgets nothing."""

    def status(self) -> dict[str, Any]:
        """See DeviceSide."""
        return {"imu frames sent": self._line.sent}
