"""A robot of CAN servos as one YAML file: buses, motors, IMU."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from core.config import config_file, errors_in, load_options
from core.errors import InputError
from core.names import check_same_names
from core.structured import distinct, one_of, positive, within
from hal.can.codec import Codec
from hal.can.codecs import make_codec
from hal.can.endpoints import EMULATED_AS, ENDPOINT, endpoint_arguments
from hal.contract.joint_map import JointMap
from hal.imu.options import ImuOptions
from hal.wire.lock import wire_name
from robot.robot import Robot

IMU = "imu"
ROUNDING = 1e-9
DEFAULT_CONFIG = "can_g1"


@dataclass(frozen=True)
class BusEntry:
    """One CAN bus. interface, channel, options: as python-can names them.

    fd: CAN-FD frames, data phase at data_bitrate. emulated_as: the transport that the emulator offers in its place.
    """

    name: str
    interface: str
    channel: str
    bitrate: int = 1_000_000
    fd: bool = False
    data_bitrate: int = 5_000_000
    options: dict = field(default_factory=dict)
    emulated_as: str | None = None

    def __post_init__(self) -> None:
        """Check what can be checked without the bus. Raises InputError."""
        for what in ("bitrate", "data_bitrate"):
            positive(what, getattr(self, what))
        if self.emulated_as is not None:
            one_of("emulated_as", self.emulated_as, EMULATED_AS, "unknown transport")
        if self.fd and self.emulated_as in ("socketcand", "slcan"):
            expected = "virtual or udp_multicast"
            raise InputError("cannot carry FD", where="emulated_as", got=self.emulated_as, expected=expected)

    @property
    def arguments(self) -> dict[str, Any]:
        """What python-can's `Bus` is to be opened with. Raises InputError on an endpoint that cannot be read."""
        if self.interface == ENDPOINT:
            return endpoint_arguments(self.channel, bitrate=self.bitrate, fd=self.fd)
        arguments: dict[str, Any] = {"interface": self.interface, "channel": self.channel, "bitrate": self.bitrate}
        if self.fd:
            arguments |= {"fd": True, "data_bitrate": self.data_bitrate}
        return arguments | self.options

    @property
    def wire(self) -> str:
        """See wire_name."""
        arguments = self.arguments
        return wire_name(
            "can", *(arguments[key] for key in ("interface", "host", "channel", "port") if key in arguments)
        )


@dataclass(frozen=True)
class Limits:
    """Narrower than the robot's own, at the joint. pos_rad: lower and upper end. torque_nm: what the motor can give."""

    pos_rad: tuple[float, float] | None = None
    torque_nm: float | None = None


@dataclass(frozen=True)
class MotorEntry:
    """One servo and its joint. id, host_id, model, options: the codec's. direction, zero_rad, gear: see JointMap.

    fold: whole motor turns are settled at start by the joint's band (single-turn encoders).
    """

    joint: str
    bus: str
    id: int
    codec: str
    model: str
    host_id: int | None = None
    direction: int = 1
    zero_rad: float = 0.0
    gear: float = 1.0
    fold: bool = True
    limits: Limits = field(default_factory=Limits)
    options: dict = field(default_factory=dict)

    def make_codec(self) -> Codec:
        """Its codec, with the ranges of the table. Raises InputError naming the joint."""
        with errors_in(f"motor of {self.joint}"):
            return make_codec(self.codec, self.id, self.model, host_id=self.host_id, **self.options)


@dataclass(frozen=True)
class RobotFile:
    """All motors of a robot on their buses, polled rate_hz times a second.

    watchdog_s: the servos' own time limit without a command. band_margin_rad: how far beyond a joint's range its motor
    may be found at start. least_torque: share of the joint's torque limit that its motor must give, whatever `limits`.
    supply_v: the nominal voltage, against which what motors report is judged; None: it is not judged.
    """

    robot: str
    rate_hz: float
    buses: tuple[BusEntry, ...]
    motors: tuple[MotorEntry, ...]
    imu: ImuOptions | None = None
    watchdog_s: float = 0.1
    band_margin_rad: float = 0.1
    least_torque: float = 0.5
    supply_v: float | None = None

    def __post_init__(self) -> None:
        """Check names, ids and figures. Raises InputError."""
        for what in ("rate_hz", "watchdog_s"):
            positive(what, getattr(self, what))
        if self.supply_v is not None:
            positive("supply_v", self.supply_v)
        within("band_margin_rad", self.band_margin_rad, 0.0, math.pi)
        within("least_torque", self.least_torque, 0.0, 1.0)
        if self.watchdog_s < 3.0 / self.rate_hz:
            expected = f"at least 3 rounds of the bus, {3e3 / self.rate_hz:g} ms"
            raise InputError("too small", where="watchdog_s", got=self.watchdog_s, expected=expected)
        known = [bus.name for bus in self.buses]
        distinct("buses", known)
        distinct("motors", [motor.joint for motor in self.motors], "more than one motor for a joint")
        if IMU in known:
            raise InputError("bus name", where="buses", got=IMU, expected="another: this one stands for the IMU")
        for i, motor in enumerate(self.motors):
            one_of(f"motors[{i} {motor.joint}].bus", motor.bus, known, "unknown bus")
        for bus in self.buses:
            self._check_bus(bus)

    @cached_property
    def codecs(self) -> tuple[Codec, ...]:
        """One per motor, with the ranges of the tables."""
        return tuple(motor.make_codec() for motor in self.motors)

    @cached_property
    def joint_map(self) -> JointMap:
        """Of all motors, in the file's order."""
        motors = self.motors
        return JointMap.of(
            [motor.joint for motor in motors],
            [motor.direction for motor in motors],
            [motor.zero_rad for motor in motors],
            [motor.gear for motor in motors],
        )

    def motors_of(self, bus: str) -> list[int]:
        """Which of the motors hang on a bus."""
        return [i for i, motor in enumerate(self.motors) if motor.bus == bus]

    def joint_order(self, robot: Robot) -> np.ndarray:
        """(N,) where each motor's joint stands in the robot. Raises InputError unless each joint has one motor."""
        check_same_names([motor.joint for motor in self.motors], robot.joint_names, where=f"motors of {robot.name}")
        return np.array([robot.joint_names.index(motor.joint) for motor in self.motors], dtype=int)

    def bands_rad(self, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
        """(N,) lower and upper end of each motor's joint, margin included. Raises InputError where ambiguous."""
        lower, upper = np.empty(len(self.motors)), np.empty(len(self.motors))
        for i, motor in enumerate(self.motors):
            lower[i], upper[i] = _range_of(motor, robot)
        lower, upper = lower - self.band_margin_rad, upper + self.band_margin_rad
        self.joint_map.check_bands(lower, upper, np.array([motor.fold for motor in self.motors], dtype=bool))
        return lower, upper

    def at(self, endpoints: Mapping[str, str]) -> "RobotFile":
        """The same robot elsewhere: an emulator's endpoints by bus name and `imu`. Raises InputError on others."""
        known = [bus.name for bus in self.buses] + [IMU]
        if unknown := sorted(set(endpoints) - set(known)):
            raise InputError("unknown wire", got=", ".join(unknown), expected=f"some of {', '.join(known)}")
        buses = tuple(
            replace(bus, interface=ENDPOINT, channel=endpoints[bus.name], options={}) if bus.name in endpoints else bus
            for bus in self.buses
        )
        imu = self.imu
        if imu is not None and IMU in endpoints:
            imu = replace(imu, port=endpoints[IMU])
        return replace(self, buses=buses, imu=imu)

    def _check_bus(self, bus: BusEntry) -> None:
        members = self.motors_of(bus.name)
        for i in members:
            if self.codecs[i].fd and not bus.fd:
                raise InputError(
                    "fd", where=f"bus {bus.name}", got="false", expected=f"true for {self.motors[i].codec}"
                )
        for i, k in combinations(members, 2):
            for one in self.codecs[i].occupied:
                for other in self.codecs[k].occupied:
                    if one.overlaps(other):
                        names = f"{self.motors[i].joint} and {self.motors[k].joint}"
                        raise InputError("motors share an identifier", where=f"bus {bus.name}", got=names)


def load_robot_file(name_or_file: str | Path = DEFAULT_CONFIG) -> RobotFile:
    """`configs/hal/<name>.yaml` or a file. Raises InputError naming file and entry."""
    return load_options(RobotFile, config_file("hal", name_or_file))


def check_motors(file: RobotFile, robot: Robot) -> None:
    """Refuse motors whose torque, gains or speed do not reach what their joints need. Raises InputError with the joint.

    A motor may be weaker than its joint's torque limit where its line says so (`limits`), down to `least_torque`.
    """
    for motor, codec in zip(file.motors, file.codecs):
        check_motor(file, motor, codec, robot)


def check_motor(file: RobotFile, motor: MotorEntry, codec: Codec, robot: Robot) -> None:
    """Likewise of one motor, with the ranges that it says it has. Raises InputError."""
    i = robot.joint_names.index(motor.joint)
    limit_nm, model = float(robot.torque_limit_nm[i]), codec.model
    needed_nm = max(min(limit_nm, motor.limits.torque_nm or math.inf), file.least_torque * limit_nm)
    # A drive that limits its speed limits the spring's torque to kd times that.
    needed_rad_s = max(float(robot.vel_limit_rad_s[i]), needed_nm / float(robot.kd[i]))
    asked = (
        ("weak", "Nm", needed_nm, min(model.torque_nm * motor.gear, motor.limits.torque_nm or math.inf)),
        ("weak", "Nm/rad", float(robot.kp[i]), model.kp * motor.gear**2),
        ("weak", "Nm s/rad", float(max(robot.kd[i], robot.damping_kd[i])), model.kd * motor.gear**2),
        ("slow", "rad/s", needed_rad_s, model.speed_limit_rad_s / motor.gear),
    )
    hints = {
        "Nm": f"torque may be limited in the file (`limits: {{torque_nm: ...}}`) down to {file.least_torque:.0%}",
        "rad/s": "raise the drive's vel_limit: it disarms beyond, and its spring gives at most kd times that",
    }
    for what, unit, needed, given in asked:
        if given < needed * (1.0 - ROUNDING):
            raise InputError(
                f"{motor.model} is too {what}",
                where=f"motor of {motor.joint}",
                got=f"{given:g} {unit} at the joint",
                expected=f"{needed:g} {unit}",
                hint=hints.get(unit),
            )


def _range_of(motor: MotorEntry, robot: Robot) -> tuple[float, float]:
    one_of(f"motor {motor.id} on {motor.bus}", motor.joint, robot.joint_names, "unknown joint")
    i = robot.joint_names.index(motor.joint)
    lower, upper = float(robot.pos_lower_rad[i]), float(robot.pos_upper_rad[i])
    if motor.limits.pos_rad is None:
        return lower, upper
    low, high = motor.limits.pos_rad
    if not lower <= low < high <= upper:
        where = f"motor of {motor.joint}: limits"
        raise InputError("pos_rad", where=where, got=[low, high], expected=f"within {lower:g} to {upper:g}")
    return low, high
