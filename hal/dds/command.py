"""LowCmd frames from the loop's commands, with the held joints' own."""

import math

import numpy as np

from hal.dds.layout import CMD
from hal.dds.slots import SLOTS, HeldMotor, SlotMap
from hal.wire.outbox import Kind, Outgoing

ENABLED, DISABLED = 1, 0
PITCH_ROLL = 0
VALUES = ("q", "dq", "tau", "kp", "kd")


class CommandFrames:
    """Builds one LowCmd after the other in the same memory. For one thread at a time.

    Motors 0 to 28 are enabled, the places without a motor stay zero. While tracking, the held joints move at
    `speed_rad_s` from where they were found to their pose, with targets whose predicted torque stays within their
    limit; while damping they are damped, and the next tracking finds them anew.
    """

    def __init__(self, slots: SlotMap, held: tuple[HeldMotor, ...], speed_rad_s: float, period_s: float) -> None:
        self._slots = slots
        self._frame = CMD.empty()
        self._motors = self._frame["motor_cmd"]
        self._numbers = [self._motors[name] for name in VALUES]
        self._step_rad = speed_rad_s * period_s
        self._goal_rad = np.array([joint.pos_rad for joint in held])
        self._kp = np.array([joint.kp for joint in held])
        self._kd = np.array([joint.kd for joint in held])
        self._damping_kd = np.array([joint.damping_kd for joint in held])
        self._torque_nm = np.array([joint.torque_nm for joint in held])
        self._target_rad = np.full(len(held), np.nan)

    def body(self, outgoing: Outgoing, mode_machine: int, motor_state: np.ndarray) -> bytes:
        """The serialised LowCmd for what is to be sent. motor_state: (35,) of the newest LowState.

        Raises ValueError where a value does not fit a 32-bit float, and for IDLE, which has no frame.
        """
        if outgoing.command is None:
            raise ValueError("LowCmd: got IDLE, expected something to send")
        self._motors["mode"][:SLOTS] = ENABLED
        command = outgoing.command
        self._set(self._slots.robot, command.q_rad, command.dq_rad_s, command.tau_nm, command.kp, command.kd)
        if outgoing.kind is Kind.TRACK:
            self._hold(motor_state[self._slots.held])
        else:
            self._target_rad = np.full_like(self._goal_rad, np.nan)
            self._damp_held()
        return self._sealed(mode_machine)

    def disabled_body(self, mode_machine: int) -> bytes:
        """The serialised LowCmd that takes the drive away from every motor."""
        self._frame[()] = np.zeros((), dtype=self._frame.dtype)
        self._target_rad = np.full_like(self._goal_rad, np.nan)
        return self._sealed(mode_machine)

    def _set(self, places: np.ndarray, *values: np.ndarray) -> None:
        """In the order of VALUES."""
        for numbers, value in zip(self._numbers, values):
            numbers[places] = value

    def _hold(self, seen: np.ndarray) -> None:
        """seen: (H,) state of the held motors. One whose state is no number is damped."""
        pos_rad, vel_rad_s = seen["q"].astype(float), seen["dq"].astype(float)
        known = np.isfinite(pos_rad) & np.isfinite(vel_rad_s)
        wanted = np.where(np.isnan(self._target_rad), pos_rad, self._target_rad)
        wanted += np.clip(self._goal_rad - wanted, -self._step_rad, self._step_rad)
        self._target_rad = np.where(known, wanted, np.nan)
        reach_nm = np.maximum(0.0, self._torque_nm - self._kd * np.abs(vel_rad_s))
        reach_rad = np.divide(reach_nm, self._kp, out=np.zeros_like(reach_nm), where=self._kp > 0)
        target_rad = np.clip(wanted, pos_rad - reach_rad, pos_rad + reach_rad)
        zero = np.zeros_like(pos_rad)
        kp, kd = np.where(known, self._kp, 0.0), np.where(known, self._kd, self._damping_kd)
        self._set(self._slots.held, np.where(known, target_rad, 0.0), zero, zero, kp, kd)

    def _damp_held(self) -> None:
        zero = np.zeros_like(self._goal_rad)
        self._set(self._slots.held, zero, zero, zero, zero, self._damping_kd)

    def _sealed(self, mode_machine: int) -> bytes:
        self._frame["mode_pr"], self._frame["mode_machine"] = PITCH_ROLL, mode_machine
        for name, numbers in zip(VALUES, self._numbers):
            if not math.isfinite(numbers.sum()) and not np.isfinite(numbers).all():
                raise ValueError(f"LowCmd: {name} does not fit a 32-bit float: {numbers}")
        CMD.seal(self._frame)
        return CMD.to_body(self._frame)
