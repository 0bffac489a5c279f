"""A robot of CAN servos and a serial IMU, for the wire process."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from core.errors import InputError
from hal.can.bus import CanBus
from hal.can.bus_load import BusLoad, bus_loads, check_loads
from hal.can.motor import Motor
from hal.can.robot_file import RobotFile, check_motor, check_motors, load_robot_file
from hal.can.setup import bring_back, commanded_by_others, prepare, switch_off, switch_on
from hal.contract.types import DeviceError, DeviceFault, DeviceInfo
from hal.imu.reader import ImuReader
from hal.wire.adapter import adapter_serial
from hal.wire.boards import StateBoard
from hal.wire.driver import Cycle, Damper, WireFactory
from hal.wire.outbox import Outbox
from robot.robot import Robot


def make_factory(config: str | Path, endpoints: Mapping[str, str]) -> WireFactory:
    """See hal/open.py. endpoints: by bus name and `imu`. Refuses a rate above 80 % of a wire's ceiling."""
    file = load_robot_file(config)
    check_loads(bus_loads(file))
    file = file.at(endpoints)
    return WireFactory(CanDriver, file, wires=tuple(bus.wire for bus in file.buses if file.motors_of(bus.name)))


class CanDriver:
    """See hal.wire.driver.Driver. Damping: each codec's frame with kp = 0 and the robot's damping kd.

    Raises InputError where the file does not fit the robot.
    """

    def __init__(self, robot: Robot, file: RobotFile) -> None:
        file.joint_order(robot)
        check_motors(file, robot)
        if file.imu is None:
            raise InputError("no imu", where="CAN robot", hint="a robot that is to balance needs one in its file")
        self.joint_names = robot.joint_names
        self._robot, self._file = robot, file
        self._buses = [CanBus(file, bus.name, robot) for bus in file.buses if file.motors_of(bus.name)]
        self._imu = ImuReader(file.imu)
        self._energised = False

    def identify(self) -> DeviceInfo:
        """See Driver. Refuses also where another controller commands the motors."""
        details: dict[str, str] = {}
        problems = self._each_bus(self._identify_bus)
        try:
            details["imu"] = self._imu.identify()
        except DeviceError as error:
            problems.append(str(error))
        if problems:
            raise DeviceFault("; ".join(problems))
        loads = {load.bus: load for load in bus_loads(self._file)}
        for bus in self._buses:
            details[f"bus {bus.name}"] = _bus_line(bus, loads[bus.name])
            details |= {motor.joint: _motor_line(bus, motor) for motor in bus.motors}
        return DeviceInfo(
            "can", self.joint_names, self._watchdog_line(), details, self._identities(), self._gain_limits()
        )

    def dampers(self) -> Sequence[Damper]:
        """See Driver."""
        return [bus.damper() for bus in self._buses]

    def start(self, outbox: Outbox, state: StateBoard) -> Sequence[Cycle]:
        """See Driver. The buses take turns within a period: their threads share one interpreter."""
        stride_s = 1.0 / (self._file.rate_hz * len(self._buses))
        cycles = [bus.cycle(outbox, state, phase_s=i * stride_s) for i, bus in enumerate(self._buses)]
        return [*cycles, self._imu.cycle(state)]

    def enable(self) -> None:
        """See Driver."""
        self._energised = True
        _raise_all(self._each_motor(switch_on))

    def disable(self) -> None:
        """See Driver."""
        self._energised = False

        def release(bus: CanBus) -> list[str]:
            bus.end_rounds()
            switch_off(bus, bus.motors)
            return []

        _raise_all(self._each_bus(release))

    def acknowledge(self) -> None:
        """See Driver."""

        def bring(bus: CanBus, motor: Motor) -> None:
            if motor.damped_only or motor.enabled != self._energised:
                bring_back(bus, motor, self._file.watchdog_s, on=self._energised)

        def mend(bus: CanBus) -> list[str]:
            bus.mend()
            return []

        _raise_all(self._each_bus(mend) or self._each_motor(bring))

    def close(self) -> None:
        """See Driver."""
        for bus in self._buses:
            bus.close()
        self._imu.close()

    def _identify_bus(self, bus: CanBus) -> list[str]:
        bus.link.open()
        if strangers := commanded_by_others(bus):
            return [f"bus {bus.name}: another controller commands {', '.join(strangers)}"]
        interface = bus.link.interface
        return [
            *([] if interface is None else interface.problems),
            *_collected(lambda m: self._prepare(bus, m), bus.motors),
        ]

    def _prepare(self, bus: CanBus, motor: Motor) -> None:
        prepare(bus, motor, self._file.watchdog_s)
        entry = next(entry for entry in self._file.motors if entry.joint == motor.joint)
        try:
            check_motor(self._file, entry, motor.codec, self._robot)
        except InputError as error:
            raise DeviceFault(str(error)) from error

    def _gain_limits(self) -> dict[str, tuple[float, float]]:
        """See DeviceInfo."""
        gears = {entry.joint: entry.gear for entry in self._file.motors}
        models = {motor.joint: motor.codec.model for bus in self._buses for motor in bus.motors}
        return {joint: (gears[joint] ** 2 * model.kp, gears[joint] ** 2 * model.kd) for joint, model in models.items()}

    def _identities(self) -> dict[str, str]:
        """See DeviceInfo."""
        motors = {
            motor.joint: f"{motor.codec.name} {motor.serial}"
            for bus in self._buses
            for motor in bus.motors
            if motor.serial
        }
        adapters = {f"bus {bus.name}": bus.link.serial for bus in self._buses}
        assert self._file.imu is not None
        adapters["imu"] = adapter_serial(self._file.imu.port, "tty")
        return motors | {name: f"adapter {serial}" for name, serial in adapters.items() if serial}

    def _each_bus(self, action: Callable[[CanBus], list[str]]) -> list[str]:
        """Do something to all buses at the same time; what went wrong."""

        def guarded(bus: CanBus) -> list[str]:
            try:
                return action(bus)
            except DeviceError as error:
                return [str(error)]

        with ThreadPoolExecutor(len(self._buses)) as pool:
            return [problem for problems in pool.map(guarded, self._buses) for problem in problems]

    def _each_motor(self, action: Callable[[CanBus, Motor], None]) -> list[str]:
        return self._each_bus(lambda bus: _collected(lambda motor: action(bus, motor), bus.motors))

    def _watchdog_line(self) -> str:
        """What the servos do by themselves, by protocol, and those that can be trusted to do nothing."""
        motors = [motor for bus in self._buses for motor in bus.motors]
        does = {motor.codec.name: motor.codec.watchdog_damps for motor in motors if motor.codec.has_watchdog}
        words = [f"{name} {'damps' if damps else 'lets go'}" for name, damps in sorted(does.items())]
        lines = (
            [f"each servo's own, {1e3 * self._file.watchdog_s:.0f} ms, read back: {', '.join(words)}"] if does else []
        )
        if without := [motor.joint for motor in motors if not motor.codec.has_watchdog]:
            lines.append(f"none that can be set: {', '.join(without)}")
        return "; ".join(lines)


def _collected(action: Callable[[Motor], None], motors: Iterable[Motor]) -> list[str]:
    """One motor that fails hinders no other."""
    problems = []
    for motor in motors:
        try:
            action(motor)
        except DeviceError as error:
            problems.append(str(error))
    return problems


def _bus_line(bus: CanBus, load: BusLoad) -> str:
    interface = "" if bus.link.interface is None else f", {bus.link.interface}"
    return (
        f"{bus.link.where}, {load.motors} motors, {load.rate_hz:g} Hz is {load.load:.0%} of the wire's "
        f"{load.ceiling_hz:.0f} Hz, {bus.link.error_frames} error frames{interface}"
    )


def _motor_line(bus: CanBus, motor: Motor) -> str:
    warmth = "" if motor.temperature_c != motor.temperature_c else f", {motor.temperature_c:.0f} C"
    turns = int(bus.map.turns[motor.row])
    folded = f", {turns:+d} turns" if turns else ""
    serial = f", serial number {motor.serial}" if motor.serial else ", no serial number"
    return (
        f"{motor.codec.name} {motor.codec.model.name} id {motor.codec.motor_id} on {bus.name}{serial}{warmth}{folded}"
    )


def _raise_all(problems: Sequence[str]) -> None:
    if problems:
        raise DeviceFault("; ".join(problems))
