"""The device side of Dynamixel ports: servos that answer at the pace of their wire, on pseudo-terminals."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from core import robot_time as time
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel.protocol2 import Answer, Packet, PacketParser
from hal.dynamixel.robot_file import DynamixelOptions, PortOptions, joint_map, load_dynamixel
from hal.emulator.device import DeviceSide, Worker
from hal.emulator.dynamixel_servo import ROOM_C, EmulatedServo, command_of_another
from hal.emulator.faults import SECOND_CONTROLLER, DelayLine, FaultKind, Faults
from hal.emulator.imu import IMU_FAULTS, KEY, ImuLine
from hal.emulator.pty import Terminal
from hal.emulator.robot import EmulatedRobot, Joints
from hal.imu.options import BITS_PER_BYTE

LOOK_S = 0.01
BOOT_S = 0.3
RETURN_DELAY_UNIT_S = 2e-6
OVERLOAD = 1 << 5
WRONG_ID_STEP = 100


class PortLine:
    """The servos of one port. The port's name and the servos' joints are the keys of faults.

    Answers leave when the request and they themselves have had their time on the wire. A servo that stays silent
    silences those that a sync read asks after it: the strictest reading of the protocol.
    """

    def __init__(self, robot: EmulatedRobot, faults: Faults, options: DynamixelOptions, port: PortOptions) -> None:
        self._robot, self._faults, self._options = robot, faults, port
        chosen = options.on(port)
        maps = joint_map(chosen, robot.robot)
        self.servos = {
            servo.id: EmulatedServo(servo.id, servo.joint, options.model(servo), maps.take([row]), options.supply_v)
            for row, servo in enumerate(chosen)
        }
        self._joint = {servo.id: robot.joint_names.index(servo.joint) for servo in chosen}
        for servo_id, servo in self.servos.items():
            joint = self._joint[servo_id]
            robot.checks.kp_max[joint], robot.checks.kd_max[joint] = servo.gain_limits()
        self.counts: Counter[str] = Counter()
        self._wanted_boot = True
        self._booting: dict[int, float] = {}
        self._unpowered: set[int] = set()
        self._heard_s = self._house_s = 0.0
        self._parser = PacketParser()
        self._line: DelayLine[bytes] = DelayLine()
        self._terminal: Terminal | None = None
        self._worker = Worker(port.name, self._round)

    @property
    def path(self) -> str:
        """Where the host connects; empty before `start`."""
        return "" if self._terminal is None else self._terminal.path

    @property
    def failure(self) -> Exception | None:
        """What ended its thread, if anything did."""
        return self._worker.failure

    def start(self) -> None:
        """Begin to answer."""
        self._terminal = Terminal(self._options.name)
        self._heard_s = time.monotonic()
        self._worker.start()

    def stop(self) -> None:
        """May be repeated."""
        self._worker.stop()
        if self._terminal is not None:
            self._terminal.close()

    def reset(self) -> None:
        """Switch every servo off and on, at the next round."""
        self._wanted_boot = True

    def _round(self, now_s: float) -> None:
        terminal = self._terminal
        assert terminal is not None
        if now_s >= self._house_s:
            self._house_s = now_s + LOOK_S
            self._keep_house(now_s)
        if self._faults.active("reconnect", self._options.name):
            terminal.unplug()
            time.sleep(LOOK_S)
            return
        terminal.plug_in()
        data = terminal.read(max(0.0, min(LOOK_S, self._line.due_s - now_s)))
        if data:
            arrived_s = time.monotonic()
            with self._robot.lock:
                for packet in self._parser.feed(data):
                    self._hear(packet, arrived_s + len(data) * BITS_PER_BYTE / self._options.baud)
                self._obey()
        else:
            self._watch(time.monotonic())
        for answer in self._line.arrived(time.monotonic()):
            terminal.write(answer)

    def _keep_house(self, now_s: float) -> None:
        """Power, heat and faults of the servos."""
        if self._wanted_boot:
            self._wanted_boot = False
            for servo in self.servos.values():
                self._power_up(servo)
        for servo in self.servos.values():
            self._check_power(servo, now_s)
            heat = self._faults.value("over_temperature", servo.joint)
            servo.warm(ROOM_C if heat is None else heat)
            if (code := self._faults.value("fault_code", servo.joint)) is not None:
                servo.fail(OVERLOAD if code < 0 else int(code) & 0xFF)
        if self._terminal is not None and self._faults.active("second_controller", self._options.name):
            self._terminal.write(command_of_another(self.servos.values()))
        self._obey()

    def _watch(self, now_s: float) -> None:
        """Nothing has been heard, and nothing waits to be: the servos' watchdogs look at the clock."""
        for servo in self.servos.values():
            servo.watch(now_s - self._heard_s)
        self._obey()

    def _check_power(self, servo: EmulatedServo, now_s: float) -> None:
        if not self._faults.powered(servo.joint, self._options.name):
            if servo.id not in self._unpowered:
                self._unpowered.add(servo.id)
                self._power_up(servo)
            self._booting[servo.id] = now_s + BOOT_S
        elif self._booting.get(servo.id, now_s) < now_s:
            self._unpowered.discard(servo.id)
            del self._booting[servo.id]

    def _power_up(self, servo: EmulatedServo) -> None:
        pos_rad = self._robot.joints().pos_rad[self._joint[servo.id]]
        servo.power_up(round(servo.true_counts(pos_rad)))

    def _obey(self) -> None:
        for servo_id, servo in self.servos.items():
            if servo.dirty:
                servo.drive(self._robot, self._joint[servo_id])

    def _hear(self, packet: Packet, end_s: float) -> None:
        """One packet, whose last byte is on the wire until end_s."""
        self._heard_s = end_s
        self.counts["heard"] += 1
        if packet.instruction == p2.SYNC_WRITE:
            self._sync_write(packet.params)
        elif packet.instruction in (p2.SYNC_READ, p2.FAST_SYNC_READ):
            if asked := p2.sync_read_of(packet.params):
                self._sync_read(*asked, end_s, fast=packet.instruction == p2.FAST_SYNC_READ)
        elif packet.id in self.servos or packet.id == p2.BROADCAST:
            self._answer_each(packet, end_s)

    def _sync_write(self, params: bytes) -> None:
        content = p2.sync_write_of(params)
        if content is None:
            self.counts["malformed"] += 1
            return
        address, data = content
        for servo_id, datum in data.items():
            servo = self.servos.get(servo_id)
            if servo is not None and self._hears(servo) and servo.write(address, datum):
                self.counts["refused writes"] += 1
                self.counts[f"refused write of register {address}"] += 1

    def _sync_read(self, address: int, size: int, ids: bytes, end_s: float, *, fast: bool) -> None:
        answers: list[Answer] = []
        delay_s = 0.0
        state = self._robot.joints()
        for servo_id in ids:
            servo = self.servos.get(servo_id)
            if servo is None or not self._hears(servo):
                break
            fate = self._faults.fate(servo.joint, self._options.name)
            if fate.lost:
                break
            delay_s += fate.delay_s + servo.get(r.RETURN_DELAY) * RETURN_DELAY_UNIT_S
            self._measure(servo, state)
            error, data = servo.read(address, size)
            shown = (servo_id + WRONG_ID_STEP) % (p2.MAX_ID + 1) if fate.wrong_id else servo_id
            answers.append(Answer(shown, error | servo.alert, data))
        frames = [p2.status(answer.id, answer.error, answer.data) for answer in answers]
        if fast and answers:
            frames = [p2.fast_status(answers, size, len(ids))]
        self._reply(frames, answers, end_s + delay_s)

    def _answer_each(self, packet: Packet, end_s: float) -> None:
        for servo in self.servos.values():
            if packet.id not in (servo.id, p2.BROADCAST) or not self._hears(servo):
                continue
            error, data = self._do(servo, packet)
            fate = self._faults.fate(servo.joint, self._options.name)
            if fate.lost or (packet.id == p2.BROADCAST and packet.instruction != p2.PING):
                continue
            shown = (servo.id + WRONG_ID_STEP) % (p2.MAX_ID + 1) if fate.wrong_id else servo.id
            delay_s = fate.delay_s + servo.get(r.RETURN_DELAY) * RETURN_DELAY_UNIT_S
            answer = Answer(shown, error | servo.alert, data)
            self._reply([p2.status(*answer)], [answer], end_s + delay_s)

    def _do(self, servo: EmulatedServo, packet: Packet) -> tuple[int, bytes]:
        """Error and data of one instruction to one servo."""
        match packet.instruction, packet.params:
            case p2.PING, _:
                return 0, bytes(servo.table[0:2]) + bytes(servo.table[6:7])
            case p2.READ, params if len(params) == 4:
                self._measure(servo, self._robot.joints())
                return servo.read(int.from_bytes(params[:2], "little"), int.from_bytes(params[2:], "little"))
            case p2.WRITE, params if len(params) > 2:
                return servo.write(int.from_bytes(params[:2], "little"), params[2:]), b""
            case p2.REBOOT, _:
                self._power_up(servo)
                self._unpowered.add(servo.id)
                self._booting[servo.id] = time.monotonic() + BOOT_S
                return 0, b""
        return p2.BAD_INSTRUCTION, b""

    def _measure(self, servo: EmulatedServo, state: Joints) -> None:
        """Put a servo's part of the robot's state into its table."""
        joint = self._joint[servo.id]
        kinds = ("power_cycled_zero", "wrong_position", "wrong_speed")
        lost_rad, wrong_rad, wrong_rad_s = (self._faults.value(kind, servo.joint) or 0.0 for kind in kinds)
        pos_rad, vel_rad_s, torque_nm = (values[joint] for values in state)
        said = servo.measure(pos_rad, vel_rad_s + wrong_rad_s, torque_nm, lost_rad + wrong_rad)
        self._robot.report(joint, *said)

    def _hears(self, servo: EmulatedServo) -> bool:
        return servo.id not in self._unpowered and self._faults.hears(servo.joint, self._options.name)

    def _reply(self, frames: list[bytes], answers: Sequence[Answer], start_s: float) -> None:
        """Put on their way one frame for each answer or, of a fast read, one for all; altered where a fault says so."""
        for i, answer in enumerate(answers):
            servo = self.servos.get(answer.id)
            if servo is not None and self._faults.fate(servo.joint, self._options.name).corrupted:
                if len(frames) == len(answers):
                    frames[i] = self._faults.corrupted(frames[i])
                else:
                    part = p2.fast_part(len(answer.data), i)
                    spoilt = self._faults.corrupted(frames[0][part])
                    frames[0] = frames[0][: part.start] + spoilt + frames[0][part.stop :]
        data = b"".join(frames)
        self.counts["answers"] += len(answers)
        self._line.put(start_s + len(data) * BITS_PER_BYTE / self._options.baud, data)


class DynamixelDevice(DeviceSide):
    """All ports of a robot file, and its IMU."""

    default_config = "dynamixel_g1"
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {**IMU_FAULTS, "second_controller": SECOND_CONTROLLER}

    def __init__(self, robot: EmulatedRobot, faults: Faults, config: str) -> None:
        options = load_dynamixel(config)
        robot.robot.joint_index([servo.joint for servo in options.servos])
        self._joints = robot.joint_names
        self._ports = {port.name: PortLine(robot, faults, options, port) for port in options.ports}
        self._imu = ImuLine(robot, faults, options.imu)
        self.lines = (*self._ports.values(), self._imu)

    @property
    def endpoints(self) -> Mapping[str, str]:
        """See DeviceSide."""
        return {**{name: port.path for name, port in self._ports.items()}, KEY: self._imu.path}

    @property
    def fault_keys(self) -> tuple[str, ...]:
        """See DeviceSide."""
        return (*self._joints, *self._ports, KEY)

    def reset(self) -> None:
        """See DeviceSide."""
        for port in self._ports.values():
            port.reset()

    def status(self) -> dict[str, Any]:
        """See DeviceSide."""
        ports = {name: dict(port.counts) for name, port in self._ports.items()}
        return {"ports": ports, "imu frames sent": self._imu.sent}
