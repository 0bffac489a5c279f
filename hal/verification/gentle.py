"""One joint moved a little, the others held softly; never more torque than a small share of each joint's limit."""

import numpy as np

from core.clock import Clock
from hal.contract.backend import CLOSE_LIMIT_S, Backend
from hal.contract.types import DeviceFault, RobotState
from hal.verification.options import VerifyOptions
from robot.robot import Robot
from world.actuation import JointCommand

CALM_TICKS = 5


class GentleMover:
    """Moves joints of a backend that is damped, and leaves it damped again. Positions are those of the backend."""

    def __init__(self, backend: Backend, robot: Robot, clock: Clock, options: VerifyOptions) -> None:
        self._backend, self._robot, self._clock, self._options = backend, robot, clock, options
        self._kp, self._kd = options.gain_share * robot.kp, options.gain_share * robot.kd
        self._reach_rad = options.torque_share * robot.torque_limit_nm / self._kp
        self._zero = np.zeros(robot.num_joints)

    def rest(self) -> None:
        """Damp until the joints hardly move, for a few seconds at most."""
        start_s, period_s, tick, calm = self._clock.now_s(), self._backend.control_period_s, 0, 0
        while calm < CALM_TICKS and tick * period_s < CLOSE_LIMIT_S:
            tick += 1
            self._clock.sleep_until(start_s + tick * period_s)
            self._backend.damp()
            calm = calm + 1 if np.abs(self._read().joint_vel_rad_s).max() < self._options.still_rad_s else 0

    def signs(self, index: int) -> tuple[float, float]:
        """Which way to turn a joint first, and which if it is stuck that way."""
        near_end = self._read().joint_pos_rad[index] + 2 * self._options.by_rad > self._robot.pos_upper_rad[index]
        return (-1.0, 1.0) if near_end else (1.0, -1.0)

    def turn(self, index: int, sign: float) -> RobotState | None:
        """Turn a joint by `by_rad`. The state then; None where it is stuck. Raises what a device reports."""
        options, period_s = self._options, self._backend.control_period_s
        state = self._read()
        held_rad = state.joint_pos_rad.copy()
        target_rad, goal_rad, pushed_s, tick = held_rad.copy(), held_rad[index] + sign * options.by_rad, 0.0, 0
        start_s = self._clock.now_s()
        try:
            while sign * (state.joint_pos_rad[index] - goal_rad) < 0:
                tick += 1
                target_rad[index] = held_rad[index] + sign * options.speed_rad_s * tick * period_s
                self._pull(target_rad, state, min(1.0, tick * period_s / max(options.ease_s, period_s)))
                self._clock.sleep_until(start_s + tick * period_s)
                state = self._read()
                at_limit = abs(target_rad[index] - state.joint_pos_rad[index]) > self._reach_rad[index]
                pushed_s = pushed_s + period_s if at_limit else 0.0
                if pushed_s > options.stuck_s:
                    return None
        finally:
            self._backend.damp()
        return state

    def _pull(self, target_rad: np.ndarray, state: RobotState, share: float) -> None:
        near_rad = np.clip(target_rad, state.joint_pos_rad - self._reach_rad, state.joint_pos_rad + self._reach_rad)
        self._backend.write(JointCommand(near_rad, self._zero, share * self._kp, self._kd, self._zero))

    def _read(self) -> RobotState:
        state = self._backend.read()
        if state.faults:
            raise DeviceFault(f"a device reports {', '.join(state.faults)}")
        return state
