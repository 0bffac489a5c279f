"""From LowStates to the state board: values by joint, faults, modes, the remote."""

import numpy as np

from hal.dds.remote import decode_remote
from hal.dds.slots import COMMAND_TIMEOUT, DISCONNECTED, SLOT_NAMES, SLOTS, SlotMap, fault_words
from hal.dds.tick_clock import TickClock, went_back
from hal.wire.boards import StateBoard

MODE_GRACE_S = 0.5
RESTART_MS = 1000  # a tick below it, or further back, is of a new start; else a message was overtaken
NOT_OURS = "its own controller may drive the robot: end this run, begin another"


class StateWriter:
    """Puts each LowState on the board. `hear` is for one thread.

    A disconnected motor's values are not renewed. Faults that the robot reports last as long as it reports them;
    a tick that went back and a changed machine stay until `acknowledge`. lost: why the robot is no longer this run's;
    that stays.
    """

    def __init__(self, board: StateBoard, slots: SlotMap, clock: TickClock, mode_machine: int) -> None:
        self._board, self._slots, self._clock = board, slots, clock
        self._mode_machine = mode_machine
        self._tick: int | None = None
        self._motorstate = np.zeros(SLOTS, dtype=np.uint32)
        self._connected = np.arange(len(slots.robot))
        self._motor_faults: set[str] = set()
        self._latched: set[str] = set()
        self.commanding_since_s = np.inf
        self.lost: str | None = None

    def hear(self, message: np.ndarray, now_s: float) -> None:
        """One new, intact message that arrived at now_s."""
        motors = message["motor_state"][:SLOTS]
        self._judge(message, motors["motorstate"], now_s)
        seen = motors[self._slots.robot]
        imu, alive = message["imu_state"], self._connected
        stamp_s = self._clock.measured_s(int(message["tick"]), now_s)
        self._board.joints(
            alive,
            seen["q"][alive],
            seen["dq"][alive],
            seen["tau_est"][alive],
            seen["temperature"].max(axis=1)[alive],
            stamp_s,
        )
        self._board.imu(imu["quaternion"], imu["gyroscope"], imu["accelerometer"], stamp_s)
        remote = decode_remote(message["wireless_remote"].tobytes())
        if remote is not None:
            self._board.remote(remote.buttons, now_s, remote.sticks)

    def acknowledge(self) -> None:
        """The operator's word: what was latched is forgotten."""
        for name in tuple(self._latched):
            self._board.fault(name, False)
        self._latched.clear()

    def lose(self, why: str) -> None:
        """From now on the robot may have another controller."""
        if self.lost is None:
            self.lost = f"{why}: {NOT_OURS}"
            self._board.fault(self.lost, True)

    def latch(self, name: str) -> None:
        """A fault that stays until it is acknowledged."""
        self._latched.add(name)
        self._board.fault(name, True)

    def _judge(self, message: np.ndarray, motorstate: np.ndarray, now_s: float) -> None:
        tick, machine = int(message["tick"]), int(message["mode_machine"])
        if self._tick is not None and went_back(tick, self._tick):
            if tick < RESTART_MS or went_back(tick + RESTART_MS, self._tick):
                self.lose("restarted")
            else:
                self.latch("LowState's tick went back")
        self._tick = tick
        if machine != self._mode_machine:
            self.latch(f"mode_machine is no longer {self._mode_machine}")
        settled = now_s - self.commanding_since_s > MODE_GRACE_S
        unheard = settled and bool((motorstate & COMMAND_TIMEOUT).any())
        self._board.fault("the robot hears no commands", unheard)
        self._board.fault("mode_pr: parallel motors are reported", int(message["mode_pr"]) != 0)
        if not np.array_equal(motorstate, self._motorstate):
            self._motorstate = motorstate.copy()
            self._judge_motors()

    def _judge_motors(self) -> None:
        states = [int(state) & ~COMMAND_TIMEOUT for state in self._motorstate]
        faults = {f"motor_fault:{name}: {fault_words(state)}" for name, state in zip(SLOT_NAMES, states) if state}
        for name in self._motor_faults - faults:
            self._board.fault(name, False)
        for name in faults - self._motor_faults:
            self._board.fault(name, True)
        self._motor_faults = faults
        self._connected = np.flatnonzero((self._motorstate[self._slots.robot] & DISCONNECTED) == 0)
