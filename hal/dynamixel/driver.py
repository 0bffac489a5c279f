"""A robot of Dynamixel servos and a serial IMU, for the wire process."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from core.errors import InputError
from hal.contract.types import DeviceError, DeviceFault, DeviceInfo
from hal.dynamixel.damper import ServoDamper
from hal.dynamixel.group import ServoGroup
from hal.dynamixel.port import ServoPort, latency_timer_ms
from hal.dynamixel.questions import StateQuestions
from hal.dynamixel.registers import WATCHDOG_UNIT_S
from hal.dynamixel.robot_file import DynamixelOptions, load_dynamixel, port_load, with_endpoints
from hal.dynamixel.setup import FoundServo
from hal.dynamixel.translation import Translation
from hal.imu.reader import ImuReader
from hal.wire.adapter import adapter_serial
from hal.wire.boards import StateBoard
from hal.wire.driver import Cycle, Damper, WireFactory
from hal.wire.lock import wire_name
from hal.wire.outbox import Outbox
from robot.robot import Robot

LATENCY_SHARE = 0.5


def make_factory(config: Path, endpoints: Mapping[str, str]) -> WireFactory:
    """endpoints: device files by port name, and `imu`, in place of the file's: those of an emulator, which alone has
    stand-ins. Raises InputError; opens nothing."""
    options = load_dynamixel(config)
    if not endpoints:
        options.check_real()
    options = with_endpoints(options, endpoints)
    return WireFactory(DynamixelDriver, options, wires=tuple(wire_name("serial", p.device) for p in options.ports))


class DynamixelDriver:
    """See hal.wire.driver.Driver. Damping: P = I = 0 and D for the robot's damping kd, torque on.

    Raises InputError where the file's joints are not the robot's, or a servo is too weak for its joint.
    """

    def __init__(self, robot: Robot, options: DynamixelOptions) -> None:
        robot.joint_index([servo.joint for servo in options.servos])
        self.joint_names = robot.joint_names
        self._robot, self._options = robot, options
        self._groups = [ServoGroup(options, port, robot) for port in options.ports]
        for group in self._groups:
            check_strength(group.translation, robot, options.least_torque)
        self._imu = ImuReader(options.imu)

    def identify(self) -> DeviceInfo:
        """See Driver."""
        problems: list[str] = []
        details: dict[str, str] = {}
        with ThreadPoolExecutor(len(self._groups)) as pool:
            for lines, wrong in pool.map(self._identify_port, self._groups):
                details |= lines
                problems += wrong
        try:
            details["imu"] = self._imu.identify()
        except DeviceError as error:
            problems.append(str(error))
        if problems:
            raise DeviceFault("; ".join(problems))
        watchdog_ms = 1e3 * self._options.watchdog_counts * WATCHDOG_UNIT_S
        watchdog = f"each servo's own, {watchdog_ms:.0f} ms, read back: it stops and holds where it is"
        return DeviceInfo("dynamixel", self.joint_names, watchdog, details, self._identities())

    def dampers(self) -> Sequence[Damper]:
        """See Driver."""
        return [self._damper(group) for group in self._groups]

    def start(self, outbox: Outbox, state: StateBoard) -> Sequence[Cycle]:
        """See Driver."""
        return [*(group.cycle(outbox, state) for group in self._groups), self._imu.cycle(state)]

    def enable(self) -> None:
        """See Driver."""
        self._on_all(ServoGroup.enable)

    def disable(self) -> None:
        """See Driver."""
        self._on_all(ServoGroup.disable)

    def acknowledge(self) -> None:
        """See Driver."""
        self._on_all(ServoGroup.acknowledge)

    def close(self) -> None:
        """See Driver."""
        for group in self._groups:
            group.close()
        self._imu.close()

    def _identities(self) -> dict[str, str]:
        """See DeviceInfo. Servos have no number of their own."""
        files = {f"port {group.options.name}": group.options.device for group in self._groups}
        files["imu"] = self._options.imu.port
        serials = {name: adapter_serial(device, "tty") for name, device in files.items()}
        return {name: f"adapter {serial}" for name, serial in serials.items() if serial}

    def _damper(self, group: ServoGroup) -> ServoDamper:
        options, port = group.options, ServoPort(group.options.device, group.options.baud)
        questions = StateQuestions(port, fast=options.fast_sync_read)
        joints = {servo.id: servo.joint for servo in group.servos}
        frame, watchdog = group.translation.damping_frame, self._options.watchdog_counts
        name, period_s = f"dynamixel {options.name}", 1.0 / self._options.rate_hz
        return ServoDamper(name, period_s, port, questions, joints, frame, watchdog)

    def _on_all(self, action: Callable[[ServoGroup], list[str]]) -> None:
        """Do something on all ports at once. Raises DeviceFault naming everything that went wrong."""
        with ThreadPoolExecutor(len(self._groups)) as pool:
            problems = [problem for found in pool.map(action, self._groups) for problem in found]
        if problems:
            raise DeviceFault("; ".join(problems))

    def _identify_port(self, group: ServoGroup) -> tuple[dict[str, str], list[str]]:
        """What to print about a port and its servos, and everything that is wrong."""
        lines = {f"port {group.options.name}": self._port_line(group)}
        problems = self._check_latency(group)
        try:
            found, wrong = group.identify()
        except DeviceError as error:
            return lines, [*problems, *str(error).split("; ")]
        return lines | ({} if wrong else self._servo_lines(group, found)), problems + wrong

    def _check_latency(self, group: ServoGroup) -> list[str]:
        device, period_ms = group.options.device, 1e3 / self._options.rate_hz
        latency_ms = latency_timer_ms(device)
        if latency_ms is None or latency_ms <= LATENCY_SHARE * period_ms:
            return []
        return [
            f"{device}: the adapter's latency timer is {latency_ms} ms, too slow for {self._options.rate_hz:g} Hz: "
            "write 1 to its latency_timer in /sys/bus/usb-serial/devices"
        ]

    def _port_line(self, group: ServoGroup) -> str:
        port = group.options
        latency_ms = latency_timer_ms(port.device)
        latency = "no latency timer" if latency_ms is None else f"latency timer {latency_ms} ms"
        load = f"{self._options.rate_hz:g} Hz take {100 * port_load(self._options, port):.0f} % of the wire"
        return f"{port.device} at {port.baud} baud, {len(group.servos)} servos, {load}, {latency}"

    def _servo_lines(self, group: ServoGroup, found: Sequence[FoundServo]) -> dict[str, str]:
        laws = law_lines(group.translation, self._robot)
        return {
            servo.joint: f"{servo.model.name} id {servo.id}, firmware {seen.firmware}, {seen.voltage_v:.1f} V, "
            f"{seen.temperature_c} C; {law}"
            for servo, seen, law in zip(group.servos, found, laws)
        }


def check_strength(translation: Translation, robot: Robot, least_torque: float) -> None:
    """Refuse servos that do not give this share of their joint's torque limit. Raises InputError naming the joint."""
    needed_nm = least_torque * robot.torque_limit_nm[translation.index]
    for name, given, needed in zip(translation.map.joint_names, translation.limit_nm.tolist(), needed_nm.tolist()):
        if given < needed:
            hint = "another servo, a gear, or the robot file of a lighter robot (--robot)"
            expected = f"at least {needed:.3g} Nm, {least_torque:.0%} of the joint's limit"
            raise InputError("servo is too weak", where=name, got=f"{given:.3g} Nm", expected=expected, hint=hint)


def law_lines(translation: Translation, robot: Robot) -> list[str]:
    """Per servo: stiffness, damping and torque limit that the robot asks for, and those that the servo gives."""
    kp, kd, limit = (values[translation.index] for values in (robot.kp, robot.kd, robot.torque_limit_nm))
    given_kp, given_kd = translation.given(kp, kd)
    rows = np.column_stack([kp, given_kp, kd, given_kd, limit, translation.limit_nm]).tolist()
    return [
        f"stiffness {a:g} asked, {b:.4g} given; damping {c:g} asked, {d:.3g} given; torque {e:g} asked, {f:.3g} given"
        for a, b, c, d, e, f in rows
    ]
