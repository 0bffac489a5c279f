"""The host's side without a wire process: the driver with its cycle, the outbox and the boards, in the test's own."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Self

import numpy as np

from core.config import config_file
from hal.contract.types import DeviceInfo
from hal.dds.driver import DdsDriver
from hal.dds.options import load_dds_options
from hal.emulator.launch import Emulator
from hal.wire.boards import Snapshot
from hal.wire.cycles import CycleThread
from hal.wire.outbox import Kind, Outbox
from hal.wire.shared import Boards
from tests.hal.rigs import G1
from world.actuation import JointCommand, damping_command

# A test machine is shared; nothing here depends on how quick it is.
LIMIT_S = 60.0


def wait(condition: Callable[[], Any], limit_s: float = LIMIT_S) -> Any:
    end_s = time.monotonic() + limit_s
    while not (value := condition()):
        assert time.monotonic() < end_s, "nothing happened"
        time.sleep(0.01)
    return value


def driver_for(emulator: Emulator, **changes: Any) -> DdsDriver:
    options = load_dds_options(config_file("hal", "dds"), emulator.endpoints)
    patient = {"command_hz": 100.0, "state_wait_s": LIMIT_S, "observe_s": 0.5, "state_hz": 100.0}
    return DdsDriver(G1, replace(options, **(patient | changes)))


class Host:
    """A driver that is open. Entering identifies and starts its cycle; leaving damps, disables and closes."""

    def __init__(self, emulator: Emulator, **changes: Any) -> None:
        self.driver = driver_for(emulator, **changes)
        joints = G1.num_joints
        self.board, self.state, pulse = Boards.of(memoryview(bytearray(Boards.size(joints))), joints)
        self.outbox = Outbox(self.board, G1.damping_kd, 0.02, pulse)
        self.errors: list[Exception] = []
        self._enabled = False

    def __enter__(self) -> Self:
        try:
            self.info: DeviceInfo = self.driver.identify()
        except BaseException:
            self.driver.close()
            raise
        cycles = self.driver.start(self.outbox, self.state)
        self._threads = [CycleThread(cycle, lambda _, error: self.errors.append(error)) for cycle in cycles]
        for thread in self._threads:
            thread.start()
        wait(self.seen)
        return self

    def __exit__(self, *_: object) -> None:
        self.outbox.halt()
        for thread in self._threads:
            thread.stop(LIMIT_S)
        if self._enabled:
            self.driver.disable()
        self.driver.close()

    def enable(self) -> None:
        self._enabled = True
        try:
            self.driver.enable()
        finally:
            self.outbox.energise()

    def seen(self) -> Snapshot | None:
        return self.state.snapshot()

    @property
    def faults(self) -> tuple[str, ...]:
        return self.state.texts()[0]

    def damp(self) -> None:
        self.board.post(Kind.DAMP, time.monotonic(), damping_command(G1.damping_kd))

    def hold(self, q_rad: np.ndarray, until: Callable[[], Any]) -> None:
        """Command a pose until something is so. Where the machine was too busy to renew it, take up again."""
        zero = np.zeros(G1.num_joints)
        end_s = time.monotonic() + LIMIT_S
        while not until():
            assert time.monotonic() < end_s, "nothing happened"
            if self.outbox.latched:
                self.outbox.acknowledge()
            self.board.post(Kind.TRACK, time.monotonic(), JointCommand(q_rad, zero, 0.5 * G1.kp, G1.kd, zero))
            time.sleep(0.01)
