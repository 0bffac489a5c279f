"""A robot of Dynamixel servos as a YAML file says it: ports, servos, IMU; and how much of each port it uses."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.config import config_file, load_options
from core.errors import InputError
from core.structured import distinct, one_of, positive, within
from hal.contract.joint_map import JointMap
from hal.dynamixel import registers as r
from hal.dynamixel.models import Model, find_model
from hal.dynamixel.protocol2 import MAX_ID, STATUS_BYTES, fast_bytes, sync_read, sync_write
from hal.imu.options import BITS_PER_BYTE, ImuOptions
from robot.robot import Robot

BUSY_MAX = 0.8
SUPPLY_TOLERANCE = 0.15
BAND_MARGIN_RAD = 0.1


@dataclass(frozen=True)
class PortOptions:
    """One serial adapter. device: its file; fast_sync_read: all servos answer with one packet."""

    name: str
    device: str
    baud: int
    fast_sync_read: bool = False


@dataclass(frozen=True)
class ServoOptions:
    """One servo. q = direction (raw - zero_rad) / gear: see JointMap; gear: of a stage behind the horn.

    fold: whether the turn in which the servo wakes up is found from the joint's range.
    """

    joint: str
    port: str
    id: int
    model: str
    direction: int = 1
    zero_rad: float = 0.0
    gear: float = 1.0
    fold: bool = True


@dataclass(frozen=True)
class StandIn:
    """A servo that does not exist: another's electronics, with other strength and speed. For emulators."""

    name: str
    based_on: str
    stall_nm: float
    no_load_rad_s: float


@dataclass(frozen=True)
class DynamixelOptions:
    """The whole robot. supply_v: what its gains are reckoned with. watchdog_s: the servos', in steps of 20 ms.

    rate_hz: rounds per second and port. least_torque: share of a joint's torque limit that its servo must give.
    Raises InputError naming what cannot be.
    """

    rate_hz: float
    supply_v: float
    watchdog_s: float
    ports: tuple[PortOptions, ...]
    servos: tuple[ServoOptions, ...]
    imu: ImuOptions
    stand_ins: tuple[StandIn, ...] = ()
    least_torque: float = 0.5

    def __post_init__(self) -> None:
        """Check ids, names, rates and loads."""
        for name in ("rate_hz", "supply_v"):
            positive(name, getattr(self, name))
        within("watchdog_s", self.watchdog_s, r.WATCHDOG_UNIT_S, r.WATCHDOG_MAX * r.WATCHDOG_UNIT_S)
        if self.watchdog_s < 3.0 / self.rate_hz:
            expected = f"at least 3 rounds, {3.0 / self.rate_hz:.3f} s"
            raise InputError("too small", where="watchdog_s", got=self.watchdog_s, expected=expected)
        within("least_torque", self.least_torque, 0.0, 1.0)
        self._check_ports()
        self._check_servos()
        for port in self.ports:
            load = port_load(self, port)
            if load > BUSY_MAX:
                most = self.rate_hz * BUSY_MAX / load
                expected = f"at most {most:.0f} Hz for port {port.name}"
                raise InputError("too much traffic", where="rate_hz", got=self.rate_hz, expected=expected)

    def model(self, servo: ServoOptions) -> Model:
        """Raises InputError on an unknown one."""
        for stand_in in self.stand_ins:
            if stand_in.name == servo.model:
                return find_model(stand_in.based_on).stand_in(servo.model, stand_in.stall_nm, stand_in.no_load_rad_s)
        return find_model(servo.model)

    def check_real(self) -> None:
        """Raises InputError where a servo is one that does not exist."""
        names = [stand_in.name for stand_in in self.stand_ins]
        if invented := [servo.joint for servo in self.servos if servo.model in names]:
            hint = "add --emulate, or write a file of the servos that are there (configs/hal/dynamixel_desk.yaml)"
            raise InputError("stand_ins, which only an emulator has", where=", ".join(invented), hint=hint)

    @property
    def watchdog_counts(self) -> int:
        """The register's value, rounded up."""
        return math.ceil(self.watchdog_s / r.WATCHDOG_UNIT_S - 1e-9)

    def on(self, port: PortOptions) -> tuple[ServoOptions, ...]:
        """The servos of one port."""
        return tuple(servo for servo in self.servos if servo.port == port.name)

    def _check_ports(self) -> None:
        distinct("ports", [port.name for port in self.ports])
        distinct("devices", [port.device for port in self.ports] + [self.imu.port])
        for i, port in enumerate(self.ports):
            one_of(f"ports[{i} {port.name}].baud", port.baud, r.BAUDS)
            if not self.on(port):
                raise InputError("no servo", where=f"ports[{i} {port.name}]")

    def _check_servos(self) -> None:
        names = [port.name for port in self.ports]
        distinct("joints", [servo.joint for servo in self.servos])
        distinct("ids", [f"{servo.id} on port {servo.port}" for servo in self.servos])
        for i, servo in enumerate(self.servos):
            where = f"servos[{i} {servo.joint}]"
            one_of(f"{where}.port", servo.port, names, "unknown port")
            within(f"{where}.id", servo.id, 0, MAX_ID)
            port, model = self.ports[names.index(servo.port)], self.model(servo)
            if port.baud > model.baud_max:
                expected = f"at most {model.baud_max} for {model.name}"
                raise InputError("its port is too fast", where=where, got=f"{port.baud} baud", expected=expected)
            if port.fast_sync_read and model.fast_firmware is None:
                raise InputError("its port has fast_sync_read", where=where, got=f"a {model.name}, which lacks it")


def load_dynamixel(name_or_file: str | Path) -> DynamixelOptions:
    """Read configs/hal/NAME.yaml or a file. Raises InputError naming file and entry."""
    return load_options(DynamixelOptions, config_file("hal", name_or_file))


def with_endpoints(options: DynamixelOptions, endpoints: Mapping[str, str]) -> DynamixelOptions:
    """The same robot at other device files, by port name and `imu`: where an emulator listens."""
    ports = tuple(dataclasses.replace(port, device=endpoints.get(port.name, port.device)) for port in options.ports)
    imu = dataclasses.replace(options.imu, port=endpoints.get("imu", options.imu.port))
    return dataclasses.replace(options, ports=ports, imu=imu)


def joint_map(servos: tuple[ServoOptions, ...], robot: Robot) -> JointMap:
    """The map of some servos. Raises InputError where the joints' ranges leave the turn open."""
    mapped = JointMap.of(
        [servo.joint for servo in servos],
        [servo.direction for servo in servos],
        [servo.zero_rad for servo in servos],
        [servo.gear for servo in servos],
    )
    lower, upper = bands(robot, mapped.joint_names)
    mapped.check_bands(lower, upper, np.array([servo.fold for servo in servos]))
    return mapped


def bands(robot: Robot, joint_names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Where joints (N,) can be: their ranges, a little widened."""
    rows = np.array([robot.joint_names.index(name) for name in joint_names])
    return robot.pos_lower_rad[rows] - BAND_MARGIN_RAD, robot.pos_upper_rad[rows] + BAND_MARGIN_RAD


def port_bytes(options: DynamixelOptions, port: PortOptions) -> int:
    """Bytes on the wire in one round: gains, goals, state of all, health of one; without the rare stuffing."""
    ids = [servo.id for servo in options.on(port)]
    count = len(ids)
    gains = len(sync_write(r.GAINS_START, r.GAINS_BYTES, {i: bytes(r.GAINS_BYTES) for i in ids}))
    goals = len(sync_write(r.GOAL_POSITION.address, 4, {i: bytes(4) for i in ids}))
    request = len(sync_read(r.STATE_START, r.LONGEST_STATE_BYTES, ids))
    answers = count * (STATUS_BYTES + r.LONGEST_STATE_BYTES)
    if port.fast_sync_read:
        answers = fast_bytes(r.LONGEST_STATE_BYTES, count)
    health = 14 + STATUS_BYTES + r.HEALTH_BYTES
    return gains + goals + request + answers + health


def port_load(options: DynamixelOptions, port: PortOptions) -> float:
    """Share of the wire's time that the rounds take."""
    return options.rate_hz * port_bytes(options, port) * BITS_PER_BYTE / port.baud
