"""What an emulated G1's motors are like besides the physics: their health, and the motors of the held joints."""

import threading

import numpy as np

from hal.dds.slots import DISCONNECTED, HeldMotor
from hal.emulator.faults import Faults

OVERCURRENT, RESET = 0x1, 0x4000
TORQUE_SLACK = 1.01
INERTIA_KG_M2 = 0.01
FRICTION_NM_S = 0.05
STEP_S = 0.001
KEPT = 20


class MotorHealth:
    """What faults do to single motors, in the robot's joint order.

    A motor without power is silent and slack; back at power it stays slack, reporting a reset, until it is told mode 0.
    A motor with a fault code gives no torque while the fault lasts.
    """

    NOMINAL_CELSIUS = 35

    def __init__(self, faults: Faults, joint_names: tuple[str, ...]) -> None:
        self._faults, self._names = faults, joint_names
        self.reset()

    def reset(self) -> None:
        """As after switching on."""
        self._reset = np.zeros(len(self._names), dtype=bool)

    def told(self, joint: int, mode: int) -> None:
        """A command has arrived; mode 0 clears what is latched."""
        if mode == 0:
            self._reset[joint] = False

    def drives(self, joint: int) -> bool:
        """Whether the motor gives torque."""
        name = self._names[joint]
        return not self._reset[joint] and self._faults.powered(name) and not self._faults.active("fault_code", name)

    def unpowered(self) -> list[int]:
        """The motors that give no torque now because of a fault."""
        out = self._faults.struck("brown_out", self._names)
        self._reset |= out
        return np.flatnonzero(self._reset | self._faults.struck("fault_code", self._names)).tolist()

    def silent(self) -> np.ndarray:
        """(J,) bool: motors whose values are not renewed."""
        silent = np.zeros(len(self._names), dtype=bool)
        for kind in ("silence", "brown_out", "reconnect"):
            silent |= self._faults.struck(kind, self._names)
        return silent

    def motorstate(self) -> np.ndarray:
        """(J,) what each motor reports."""
        state = np.where(self.silent(), DISCONNECTED, np.where(self._reset, RESET, 0)).astype(np.uint32)
        for joint in np.flatnonzero(self._faults.struck("fault_code", self._names)).tolist():
            code = self._faults.value("fault_code", self._names[joint]) or 0.0
            state[joint] |= np.uint32(OVERCURRENT if code < 0 else int(code))
        return state

    def temperatures_c(self) -> np.ndarray:
        """(J,) casing and winding alike."""
        heat = np.full(len(self._names), float(self.NOMINAL_CELSIUS))
        struck, values = self._values("over_temperature")
        heat[struck] = values
        return heat

    def off(self, *kinds: str) -> np.ndarray:
        """(J,) how far each position or speed reads off, by faults of these kinds."""
        off = np.zeros(len(self._names))
        for kind in kinds:
            struck, values = self._values(kind)
            off[struck] += values
        return off

    def _values(self, kind: str) -> tuple[np.ndarray, list[float]]:
        """Whom a kind of fault strikes now, and its value for each of them."""
        struck = np.flatnonzero(self._faults.struck(kind, self._names))
        return struck, [self._faults.value(kind, self._names[joint]) or 0.0 for joint in struck.tolist()]


class HeldMotors:
    """The motors that the simulated robot has no joints for: each a small inertia with friction. Thread-safe.

    Commands that are not finite, or whose torque lies beyond the limit, are violations; they are not obeyed.
    """

    def __init__(self, held: tuple[HeldMotor, ...]) -> None:
        self.names = tuple(joint.name for joint in held)
        self.pos_rad, self.vel_rad_s = np.full(len(held), 0.2), np.zeros(len(held))
        self.violations: list[str] = []
        self._limit_nm = np.array([joint.torque_nm for joint in held])
        self._order = np.zeros((5, len(held)))  # q, dq, kp, kd, tau
        self._then_s: float | None = None
        self._lock = threading.Lock()

    def slack(self) -> None:
        """No torque from now on."""
        with self._lock:
            self._order = np.zeros_like(self._order)

    def obey(self, motors: np.ndarray, now_s: float) -> None:
        """A command (H,) for each."""
        self.advance(now_s)
        order = np.array([motors[name] for name in ("q", "dq", "kp", "kd", "tau")], dtype=float)
        order[:, motors["mode"] == 0] = 0.0
        with self._lock:
            torque_nm = np.abs(self._torque_nm(order))
            damping = (order[2] == 0) & (order[4] == 0)
            for i in np.flatnonzero(~(damping | (torque_nm <= TORQUE_SLACK * self._limit_nm))).tolist():
                if len(self.violations) < KEPT:
                    self.violations.append(f"{self.names[i]}: {order[:, i].tolist()}, {torque_nm[i]:.2f} Nm")
                order[:, i] = self._order[:, i]
            self._order = order

    def advance(self, now_s: float) -> None:
        """Bring the motors to a time on the monotonic clock."""
        with self._lock:
            steps = 0 if self._then_s is None else int(min(0.1, now_s - self._then_s) / STEP_S)
            if self._then_s is None or now_s - self._then_s > 0.1:
                self._then_s = now_s
            else:
                self._then_s += steps * STEP_S
            for _ in range(steps):
                torque_nm = np.clip(self._torque_nm(self._order), -self._limit_nm, self._limit_nm)
                # Friction and damping are taken implicitly: they never overshoot.
                drag = FRICTION_NM_S + self._order[3]
                drive = torque_nm + self._order[3] * self.vel_rad_s
                self.vel_rad_s = (INERTIA_KG_M2 * self.vel_rad_s + STEP_S * drive) / (INERTIA_KG_M2 + STEP_S * drag)
                self.pos_rad = self.pos_rad + STEP_S * self.vel_rad_s

    def _torque_nm(self, order: np.ndarray) -> np.ndarray:
        q_rad, dq_rad_s, kp, kd, tau_nm = order
        return kp * (q_rad - self.pos_rad) + kd * (dq_rad_s - self.vel_rad_s) + tau_nm
