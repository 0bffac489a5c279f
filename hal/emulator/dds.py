"""The device side of a G1 over DDS: strict about what it is told, and as fast as the robot."""

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from core import robot_time as time
from core.config import config_file, load_options
from core.errors import InputError
from hal.contract.backend import REST_SPEED_RAD_S
from hal.dds.driver import COMMAND_TOPIC
from hal.dds.layout import CMD, STATE
from hal.dds.link import LOOPBACK, DdsLink
from hal.dds.options import DdsOptions
from hal.dds.remote import BUTTONS, Remote, encode_remote
from hal.dds.slots import SLOTS, SlotMap
from hal.dds.state_reader import STATE_TOPIC
from hal.dds.types import LowCmd_, LowState_
from hal.emulator.dds_battery import BATTERY_FAULTS, EmulatedBattery
from hal.emulator.dds_domain import FreeDomain
from hal.emulator.dds_motors import HeldMotors, MotorHealth
from hal.emulator.dds_service import MODES, MotionServer
from hal.emulator.device import DeviceSide, Worker
from hal.emulator.faults import DelayLine, FaultKind, Faults
from hal.emulator.imu import IMU_FAULTS, disturbed
from hal.emulator.robot import NO_TORQUE, EmulatedRobot, Values

WIRE = "lowstate"
WRONG_MACHINE = 4
VERSION = (1, 0)
MOTOR_VOLTS = 48.0
IMU_CELSIUS = 40
Sent = tuple[bytes, np.ndarray]


class DdsDevice(DeviceSide):
    """Publishes LowState, obeys LowCmd, serves the motion service; on loopback, in a domain that nobody uses.

    A LowCmd is obeyed only if its checksum is right, its mode_machine is the robot's, its mode_pr is 0 and the motion
    service has let go; anything else is counted and dropped. A motor in mode 0 gives no torque. What was obeyed last
    stays in force for ever: the robot's own time-out is not documented, and this is the hardest case.
    """

    default_config = "dds"
    fault_kinds: ClassVar[Mapping[str, FaultKind]] = {
        "second_controller": FaultKind("somebody else sends LowCmd as well"),
        "tick_stands": FaultKind("LowState is repeated with the same tick"),
        "parallel_mode": FaultKind("reports mode_pr 1"),
        "unfilled": FaultKind("checksum, mode_machine and tick of LowState stay 0, as in the maker's simulator"),
        **IMU_FAULTS,
        **BATTERY_FAULTS,
    }

    def __init__(self, robot: EmulatedRobot, faults: Faults, config: str) -> None:
        options = load_options(DdsOptions, config_file("hal", config))
        self._robot, self._faults, self._options = robot, faults, options.emulator
        if options.emulator.motion_service not in ("", *MODES):
            expected = f"one of {', '.join(MODES)}, or empty"
            raise InputError("motion_service", where=config, got=options.emulator.motion_service, expected=expected)
        self._slots = SlotMap(robot.robot, options.held)
        self._held = HeldMotors(options.held)
        self._health = MotorHealth(faults, robot.joint_names)
        self._names, self._joints = robot.joint_names, np.arange(robot.robot.num_joints)
        self._state = STATE.empty()
        self._state["version"] = VERSION
        self._state["motor_state"]["mode"][:SLOTS], self._state["motor_state"]["vol"][:SLOTS] = 1, MOTOR_VOLTS
        self._counts: Counter[str] = Counter()
        self._line: DelayLine[Sent] = DelayLine()
        self._remote = Remote((), 0.0, 0.0, 0.0, 0.0)
        self._booted_s = time.monotonic()
        self._had_power = True
        self._domain: FreeDomain | None = None

    @property
    def endpoints(self) -> Mapping[str, str]:
        """See DeviceSide."""
        return {} if self._domain is None else {"interface": LOOPBACK, "domain": str(self._domain.number)}

    @property
    def fault_keys(self) -> tuple[str, ...]:
        """See DeviceSide. `lowstate` is the wire as a whole."""
        return (*self._names, "imu", WIRE)

    def start(self) -> None:
        """See DeviceSide."""
        self._domain = FreeDomain()
        self._link = DdsLink(self._domain.number, LOOPBACK)
        self._publisher = self._link.writer(STATE_TOPIC, LowState_)
        self._second = self._link.writer(COMMAND_TOPIC, LowCmd_)
        self._battery = EmulatedBattery(self._link, self._faults, WIRE)
        self._service = MotionServer(self._link, self._options.motion_service, self._options.release_s, self._at_rest)
        self._inbox = self._link.inbox(self._link.reader(COMMAND_TOPIC, LowCmd_), self._hear, "lowcmd")
        self._worker = Worker("lowstate", self._round, 1.0 / self._options.state_hz)
        self._worker.start()

    def stop(self) -> None:
        """See DeviceSide."""
        if self._domain is None:
            return
        self._worker.stop()
        self._inbox.stop()
        self._service.stop()
        self._domain.release()
        self._domain = None

    @property
    def failure(self) -> Exception | None:
        """See DeviceSide."""
        if self._domain is None:
            return None
        return self._worker.failure or self._inbox.failure or self._service.failure

    def reset(self) -> None:
        """See DeviceSide."""
        self._boot()
        self._counts.clear()
        self._service.selected_at_rest.clear()

    def status(self) -> dict[str, Any]:
        """See DeviceSide. Counters: LowCmds obeyed, and refused by reason; LowStates sent, skipped and lost."""
        return {
            "counts": dict(self._counts),
            "skipped": self._worker.skipped,
            "motion_service": self._service.mode,
            "selected_at_rest": list(self._service.selected_at_rest),
            "held_rad": dict(zip(self._held.names, self._held.pos_rad.tolist())),
            "held_violations": list(self._held.violations),
        }

    def request(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """`buttons`: those pressed on the remote from now on. `sticks`: where they are then, left x, y, right x, y.

        `motion_service`: have it drive in a mode again. `release_s`: how long that service takes to let go from now on.
        """
        match dict(content):
            case {"buttons": list(buttons)} if set(buttons) <= set(BUTTONS):
                self._remote = Remote(tuple(buttons), *self._remote.sticks)
            case {"sticks": [*sticks]} if len(sticks) == 4 and all(isinstance(way, int | float) for way in sticks):
                self._remote = Remote(self._remote.buttons, *map(float, sticks))
            case {"motion_service": str(mode)} if mode in MODES:
                self._service.select(mode)
            case {"release_s": int(seconds) | float(seconds)} if seconds >= 0:
                self._service.release_s = float(seconds)
            case _:
                modes = ", ".join(MODES)
                expected = (
                    f"buttons: some of {', '.join(BUTTONS)}; sticks: four numbers; motion_service: one of {modes}; "
                    "or release_s: a time"
                )
                raise InputError("unknown request", where="emulator", got=dict(content), expected=expected)
        return {}

    def _at_rest(self) -> bool:
        return bool(np.abs(self._robot.truth().joint_vel_rad_s).max() < REST_SPEED_RAD_S)

    @property
    def _machine(self) -> int:
        if self._unfilled:
            return 0
        return WRONG_MACHINE if self._faults.fate(WIRE).wrong_id else self._options.mode_machine

    @property
    def _unfilled(self) -> bool:
        return self._faults.active("unfilled", WIRE) is not None

    def _hear(self, sample: Any, now_s: float) -> None:
        if not self._faults.hears(WIRE):
            return
        message = CMD.from_body(sample.body)
        refused = self._refusal(message)
        self._counts[refused or "obeyed"] += 1
        if refused is None and message is not None:
            with self._robot.lock:
                self._obey(message["motor_cmd"][:SLOTS], now_s)

    def _refusal(self, message: np.ndarray | None) -> str | None:
        if message is None:
            return "malformed"
        if not CMD.intact(message):
            return "bad checksum"
        if int(message["mode_machine"]) != self._machine:
            return "wrong mode_machine"
        if int(message["mode_pr"]) != 0:
            return "wrong mode_pr"
        return "motion service active" if self._service.mode else None

    def _obey(self, motors: np.ndarray, now_s: float) -> None:
        modes = motors["mode"][self._slots.robot].tolist()
        columns = [motors[name][self._slots.robot].tolist() for name in ("q", "dq", "kp", "kd", "tau")]
        told: list[tuple[int, Values]] = []
        for joint, (mode, q, dq, kp, kd, tau) in enumerate(zip(modes, *columns)):
            self._health.told(joint, mode)
            if self._faults.hears(self._names[joint]):
                drives = mode and self._health.drives(joint)
                told.append((joint, (q, dq, kp, kd, tau, math.inf) if drives else NO_TORQUE))
        self._robot.command_all(told)
        self._held.obey(motors[self._slots.held], now_s)

    def _round(self, now_s: float) -> None:
        """Send one LowState, and what was delayed until now."""
        self._judge_power()
        self._battery.round(now_s)
        fate = self._faults.fate(WIRE)
        if fate.lost:
            self._counts["lowstate lost"] += 1
        else:
            body, seen = self._measured(now_s)
            self._line.put(now_s + fate.delay_s, (self._spoilt(body) if fate.corrupted else body, seen))
        for body, seen in self._line.arrived(now_s):
            self._publisher.write(LowState_(body))
            self._counts["lowstate sent"] += 1
            self._robot.report(self._joints, *seen)
        if self._faults.active("second_controller", WIRE):
            self._command_as_another()

    def _spoilt(self, body: bytes) -> bytes:
        """The body with bits flipped, not only in its padding."""
        while True:
            spoilt = self._faults.corrupted(body)
            message = STATE.from_body(spoilt)
            if message is None or not STATE.intact(message):
                return spoilt

    def _judge_power(self) -> None:
        """A robot that comes back to power starts anew; a motor that does stays disabled."""
        has_power = self._faults.powered(WIRE)
        if has_power and not self._had_power:
            self._boot()
        self._had_power = has_power
        for joint in self._health.unpowered():
            self._robot.slack(joint)

    def _boot(self) -> None:
        self._booted_s, self._line = time.monotonic(), DelayLine()
        self._service.select(self._options.motion_service)
        self._health.reset()
        self._held.slack()
        for joint in range(len(self._robot.joint_names)):
            self._robot.slack(joint)

    def _measured(self, now_s: float) -> tuple[bytes, np.ndarray]:
        """A LowState's body, and (2, J) positions and velocities in it."""
        seen, state = self._robot.measure(), self._state
        places, motors = self._slots.robot, state["motor_state"]
        self._held.advance(now_s)
        pos_rad = seen.joint_pos_rad + self._health.off("power_cycled_zero", "wrong_position")
        vel_rad_s = seen.joint_vel_rad_s + self._health.off("wrong_speed")
        alive = np.flatnonzero(~self._health.silent())
        motors["q"][places[alive]], motors["dq"][places[alive]] = pos_rad[alive], vel_rad_s[alive]
        motors["tau_est"][places[alive]] = seen.joint_torque_nm[alive]
        motors["temperature"][:SLOTS] = self._health.NOMINAL_CELSIUS
        motors["temperature"][places] = self._health.temperatures_c()[:, None]
        motors["motorstate"][places] = self._health.motorstate()
        held = self._slots.held
        motors["q"][held], motors["dq"][held] = self._held.pos_rad, self._held.vel_rad_s
        self._fill_imu(seen.imu_quat_wxyz, seen.imu_ang_vel_b, seen.imu_acc_b)
        state["mode_machine"] = self._machine
        state["mode_pr"] = int(self._faults.active("parallel_mode", WIRE) is not None)
        state["wireless_remote"] = np.frombuffer(encode_remote(self._remote), dtype=np.uint8)
        if not self._faults.active("tick_stands", WIRE):
            state["tick"] = 1 + max(0, int(1e3 * (now_s - self._booted_s)))
        STATE.seal(state)
        if self._unfilled:
            state["tick"] = state["crc"] = 0
        return STATE.to_body(state), np.stack([motors["q"][places], motors["dq"][places]]).astype(float)

    def _fill_imu(self, quat_wxyz: np.ndarray, ang_vel_b: np.ndarray, acc_b: np.ndarray) -> None:
        if not self._faults.hears("imu") or self._faults.fate("imu").lost:
            return
        quat_wxyz, acc_b = disturbed(self._faults, quat_wxyz, acc_b)
        imu = self._state["imu_state"]
        imu["quaternion"], imu["gyroscope"], imu["accelerometer"] = quat_wxyz, ang_vel_b, acc_b
        imu["rpy"], imu["temperature"] = _roll_pitch_yaw(quat_wxyz), IMU_CELSIUS

    def _command_as_another(self) -> None:
        message = CMD.empty()
        message["mode_machine"] = self._machine
        message["motor_cmd"]["mode"][:SLOTS] = 1
        message["motor_cmd"]["kd"][:SLOTS] = 8.0
        CMD.seal(message)
        self._second.write(LowCmd_(CMD.to_body(message)))


def _roll_pitch_yaw(quat_wxyz: np.ndarray) -> tuple[float, float, float]:
    """ZYX angles of a unit quaternion, rad."""
    w, x, y, z = quat_wxyz.tolist()
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return float(roll), float(pitch), float(yaw)
