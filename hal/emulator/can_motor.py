"""One emulated CAN servo of any codec, on the robot's joint: what it knows, obeys and answers."""

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from hal.can import fault_names
from hal.can.codec import (
    CONTROL_MODE,
    SUPPLY_V,
    WATCHDOG_S,
    Codec,
    CommandKind,
    DeviceCommand,
    MotorCommand,
    MotorState,
)
from hal.can.codecs import cubemars, damiao, moteus, odrive, odrive_tables, robstride, robstride_tables
from hal.can.frame import Frame
from hal.can.robot_file import MotorEntry
from hal.contract.joint_map import TURN_RAD
from hal.emulator.faults import Faults
from hal.emulator.robot import EmulatedRobot, Joints

ROOM_C = 32.0
FACTORY_WATCHDOG_S = {"moteus": moteus.DEFAULT_WATCHDOG_S}
FAULT_CODES: Mapping[str, Mapping[int, str]] = {
    "damiao": damiao.FAULTS,
    "robstride": robstride_tables.STATE_FAULTS,
    "cubemars": cubemars.FAULTS,
    "odrive": odrive_tables.ERRORS,
    "moteus": moteus.FAULTS,
}
ENABLED_BY_COMMANDS = ("moteus",)
COMMONEST = {"moteus": fault_names.UNDER_VOLTAGE}
# No code stands for exactly zero: steps of a whole range, half of one of which a motor takes for zero.
STEPS = {"damiao": 4095, "cubemars": 4095, "robstride": 65_535}
GAIN_SLACK = 1.0 + 1e-6
ODRIVE_NM_A = 0.5
NOMINAL_V, SUPPLY_FAULT = 48.0, "supply"
NEWEST_FIRMWARE = 0x00_63_00_00


@dataclass
class Joint:
    """How the motor moves its joint. index: in the robot. limit_nm: what the motor can give there."""

    index: int
    direction: float
    zero_rad: float
    gear: float
    limit_nm: float


class EmulatedMotor:
    """Wakes up disabled, within half a turn of its stored zero, with the watchdog that it has from the factory.

    Faults go by the joint's name and the bus's. supply_v: what it is supplied with.
    """

    def __init__(
        self, robot: EmulatedRobot, faults: Faults, entry: MotorEntry, codec: Codec, supply_v: float = NOMINAL_V
    ) -> None:
        self.entry, self.codec, self._supply_v = entry, codec, supply_v
        self.keys = (entry.joint, entry.bus)
        self._robot, self._faults = robot, faults
        index = robot.joint_names.index(entry.joint)
        limit_nm = min(codec.model.torque_nm * entry.gear, entry.limits.torque_nm or math.inf)
        self.joint = Joint(index, float(entry.direction), entry.zero_rad, entry.gear, limit_nm)
        square = entry.gear * entry.gear * GAIN_SLACK
        robot.checks.kp_max[index], robot.checks.kd_max[index] = codec.model.kp * square, codec.model.kd * square
        steps = STEPS.get(codec.name)
        self._zero_rad_s = GAIN_SLACK * codec.model.vel_rad_s / steps if steps else 0.0
        self._zero_nm = GAIN_SLACK * codec.model.torque_nm / steps if steps else 0.0
        self.next_s = 0.0
        self.serial = zlib.crc32(f"{entry.joint} {codec.name}".encode()) >> 1
        self.power_up(robot.joints())

    def power_up(self, measured: Joints) -> None:
        """As after switching on."""
        self.enabled = False
        self.held = MotorCommand()
        self.faults: tuple[str, ...] = ()
        self.values = {WATCHDOG_S: FACTORY_WATCHDOG_S.get(self.codec.name, 0.0)}
        self.fed_s = -math.inf
        self._was_powered = self._was_zeroed = True
        self._shift_rad = 0.0
        if not self.codec.keeps_zero:
            self._shift_rad = -self._raw_rad(measured)
        elif self.entry.fold:
            self._shift_rad = -TURN_RAD * round(self._raw_rad(measured) / TURN_RAD)
        self._robot.slack(self.joint.index)

    def keep(self, now_s: float) -> None:
        """What happens by itself: power, faults, watchdog. Called when what has arrived has been heard."""
        powered = self._faults.powered(*self.keys)
        zeroed = self._faults.active("power_cycled_zero", *self.keys) is None
        if (self._was_powered and not powered) or (self._was_zeroed and not zeroed):
            self.power_up(self._robot.joints())
        self._was_powered, self._was_zeroed = powered, zeroed
        if (code := self._faults.value("fault_code", *self.keys)) is not None and not self.faults:
            self._fail(self._fault_name(int(code)))
        limit_s = self.values[WATCHDOG_S]
        if self.enabled and 0 < limit_s < now_s - self.fed_s:
            self._expire()

    def hear(self, frame: Frame, now_s: float) -> tuple[Frame, ...]:
        """Obey a frame if it is for this motor; what it answers."""
        asked = self.codec.parse_command(frame, self.held)
        if asked is None or not self._faults.hears(*self.keys):
            return ()
        if asked.feeds_watchdog:
            self.fed_s = now_s
        self._obey(asked)
        return self._answer(asked)

    def state_frames(self) -> tuple[Frame, ...]:
        """Its state as it sends it."""
        measured, joint = self._robot.joints(), self.joint
        vel_rad_s, torque_nm = measured.vel_rad_s[joint.index], measured.torque_nm[joint.index]
        heat = self._faults.value("over_temperature", *self.keys)
        wrong_rad, wrong_rad_s = self._off("wrong_position"), self._off("wrong_speed")
        state = MotorState(
            self._raw_rad(measured) + self._shift_rad + self._lost_rad() + wrong_rad,
            joint.direction * vel_rad_s * joint.gear + wrong_rad_s,
            joint.direction * torque_nm / joint.gear,
            ROOM_C if heat is None else heat,
            self.enabled,
            self.faults,
        )
        self._robot.report(joint.index, measured.pos_rad[joint.index], vel_rad_s)
        return self.codec.feedback_frames(state)

    def _obey(self, asked: DeviceCommand) -> None:
        match asked.kind:
            case CommandKind.CONTROL | CommandKind.GAINS if asked.command is not None:
                self.held = asked.command
                if self.codec.name in ENABLED_BY_COMMANDS and not self.faults:
                    self.enabled = True
                if self.enabled:
                    self._drive()
            case CommandKind.ENABLE if not self.faults:
                self.enabled, self.held = True, MotorCommand()
                self._drive()
            case CommandKind.DISABLE:
                self._release()
            case CommandKind.CLEAR_FAULT:
                self._release()
                self.faults = ()
            case CommandKind.SET_ZERO if not self.enabled:
                self._shift_rad = -self._raw_rad(self._robot.joints())
            case CommandKind.WRITE:
                self.values[asked.name] = asked.value

    def _answer(self, asked: DeviceCommand) -> tuple[Frame, ...]:
        if asked.kind in (CommandKind.READ, CommandKind.PROBE, CommandKind.WRITE, CommandKind.IDENTIFY):
            value = self._serial() if asked.kind is CommandKind.IDENTIFY else self._value(asked.name)
            answers = self.codec.reply_frames(asked, value)
            if answers or asked.kind is not CommandKind.WRITE:
                return answers
        if self.codec.cyclic_period_s is not None and asked.kind is not CommandKind.REQUEST_STATE:
            return ()
        return self.state_frames()

    def _serial(self) -> float:
        """The maker's number of this motor; with the fault, that of another."""
        return self.serial if self._faults.active("other_motor", *self.keys) is None else self.serial ^ 1

    def _value(self, name: str) -> float:
        model = self.codec.model
        known = {
            CONTROL_MODE: float(damiao.MIT_MODE),
            damiao.POS_RANGE_RAD: model.pos_rad,
            damiao.VEL_RANGE_RAD_S: model.vel_rad_s,
            damiao.TORQUE_RANGE_NM: model.torque_nm,
            odrive.VEL_LIMIT: model.vel_rad_s / TURN_RAD,
            odrive.CURRENT_LIMIT_A: model.torque_nm / ODRIVE_NM_A,
            odrive.TORQUE_CONSTANT: ODRIVE_NM_A,
            robstride.TORQUE_LIMIT_NM: model.torque_nm,
            robstride.FIRMWARE: float(NEWEST_FIRMWARE),
        }
        if name == robstride.MECHANICAL_POS_RAD:
            return self._raw_rad(self._robot.joints()) + self._shift_rad + self._lost_rad()
        if name == SUPPLY_V:
            other_v = self._faults.value(SUPPLY_FAULT, *self.keys)
            return self._supply_v if other_v is None else other_v
        return self.values.get(name, known.get(name, 0.0))

    def _drive(self) -> None:
        """Put what is held in force, at the joint."""
        held, joint = self.held, self.joint
        sign, square = joint.direction, joint.gear * joint.gear
        dq_rad_s = held.dq_rad_s if abs(held.dq_rad_s) > self._zero_rad_s else 0.0
        tau_nm = held.tau_nm if abs(held.tau_nm) > self._zero_nm else 0.0
        turned_rad = held.q_rad - joint.zero_rad - self._shift_rad - self._lost_rad()
        self._robot.command(
            joint.index,
            sign * turned_rad / joint.gear,
            sign * dq_rad_s / joint.gear,
            held.kp * square,
            held.kd * square,
            sign * tau_nm * joint.gear,
            joint.limit_nm,
        )

    def _release(self) -> None:
        if self.enabled:
            self.enabled = False
            self._robot.slack(self.joint.index)

    def _fail(self, name: str) -> None:
        self._release()
        self.faults = (name,)

    def _expire(self) -> None:
        """The watchdog's end."""
        damped = MotorCommand(kd=self.held.kd)
        self._release()
        if self.codec.watchdog_fault is not None:
            self.faults = (self.codec.watchdog_fault,)
        if self.codec.watchdog_damps:
            self.held = damped
            self._drive()

    def _fault_name(self, code: int) -> str:
        names = FAULT_CODES[self.codec.name]
        commonest = COMMONEST.get(self.codec.name, fault_names.OVER_CURRENT)
        return names.get(code, commonest)

    def _raw_rad(self, measured: Joints) -> float:
        joint = self.joint
        return joint.direction * measured.pos_rad[joint.index] * joint.gear + joint.zero_rad

    def _lost_rad(self) -> float:
        """By how much a lost zero makes it read off, on its own side."""
        return self._off("power_cycled_zero")

    def _off(self, kind: str) -> float:
        """By how much a fault makes it read off, on its own side."""
        return self.joint.direction * (self._faults.value(kind, *self.keys) or 0.0) * self.joint.gear
