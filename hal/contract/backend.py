"""The one interface between the control loop and anything that has joints."""

import math
from abc import ABC, abstractmethod
from typing import Protocol, Self, runtime_checkable

import numpy as np

from core.clock import Clock
from hal.contract.types import DeviceError, DeviceInfo, RobotState
from world.actuation import JointCommand

REST_SPEED_RAD_S = 0.3
REST_HELD_S = 0.5
CLOSE_LIMIT_S = 3.0
CLOSE_LEAST_S = 1.0


@runtime_checkable
class Supported(Protocol):
    """A simulated robot that hangs on a gantry."""

    @property
    def gantry_attached(self) -> bool:
        """Whether the gantry pulls, the ramp after a release included."""
        ...

    def release_gantry(self) -> None:
        """Let go gently. Without effect where the gantry is off."""
        ...


@runtime_checkable
class Placeable(Protocol):
    """A simulated robot that can begin anywhere."""

    def reset_to(
        self,
        root_pos_w: np.ndarray,
        root_quat_wxyz: np.ndarray,
        joint_pos_rad: np.ndarray,
        *,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Begin an episode at a pose (3,), (4,), (J,), at rest and damped. rng: the episode's randomness."""
        ...


class Backend(ABC):
    """A device or its simulation. Opening never energises; closing always damps first.

    Use as a context manager: entering opens, leaving closes, whatever happened inside.
    A subclass sets `_is_open` when it has opened.
    _damped_since_s: since when nothing but damping was asked for, where a subclass knows; inf while it was not. It
    counts for the longest time that closing damps, of which at least 1 s is left.
    """

    def __init__(self, clock: Clock, control_period_s: float) -> None:
        if not 0 < control_period_s < math.inf:
            raise ValueError(f"control_period_s: got {control_period_s}, expected seconds above 0")
        self.clock = clock
        self.control_period_s = control_period_s
        self._is_open = False
        self._damped_since_s = math.inf

    @abstractmethod
    def open(self) -> DeviceInfo:
        """Connect and identify. Raises DeviceError; energises nothing."""

    @abstractmethod
    def read(self) -> RobotState:
        """Latest state with true ages. Raises NoState before the first complete one, LinkLost on a dead link."""

    @abstractmethod
    def write(self, command: JointCommand) -> None:
        """Hand a command to the sender, which repeats it until the next one or until its dead man latches.

        While the dead man is latched the command is not sent; `read()` then shows the fault "dead_man".
        """

    @abstractmethod
    def damp(self) -> None:
        """kp = 0 with the robot's damping kd on every joint. Needs no state; may be repeated."""

    def undamped(self) -> tuple[str, ...] | None:
        """Joints that are not known to be damped: not heard since damping went out to them. None: nothing went out.

        What is simulated in this process hears everything.
        """
        return ()

    @abstractmethod
    def acknowledge(self) -> None:
        """Clear a latched dead man on the operator's word. The joints stay damped."""

    @abstractmethod
    def _disable(self) -> None:
        """Take the drive away from every joint and let the device go."""

    def close(self) -> None:
        """Damp until the joints rest (below 0.3 rad/s for 0.5 s, at most 3 s), then disable. May be repeated."""
        if not self._is_open:
            return
        try:
            self._damp_to_rest()
        finally:
            self._is_open = False
            self._disable()

    def __enter__(self) -> Self:
        """Open."""
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        """Close, whatever happened inside."""
        self.close()

    def _damp_to_rest(self) -> None:
        start_s = self.clock.now_s()
        end_s = max(min(start_s, self._damped_since_s) + CLOSE_LIMIT_S, start_s + CLOSE_LEAST_S)
        resting_since_s: float | None = None
        self.damp()
        tick = 0
        while self.clock.now_s() < end_s:
            tick += 1
            self.clock.sleep_until(start_s + tick * self.control_period_s)
            self.damp()
            try:
                speed = np.abs(self.read().joint_vel_rad_s).max()
            except DeviceError:
                speed = np.inf
            now_s = self.clock.now_s()
            if not speed < REST_SPEED_RAD_S:
                resting_since_s = None
            elif resting_since_s is None:
                resting_since_s = now_s
            elif now_s - resting_since_s >= REST_HELD_S:
                return
