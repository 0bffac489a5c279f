"""What a wire's driver must do. It lives in the wire process, which owns the wire."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from hal.contract.types import DeviceInfo
from hal.wire.boards import StateBoard
from hal.wire.outbox import Outbox
from robot.robot import Robot

LINK_TIMEOUT_S = 0.1


@dataclass(frozen=True)
class Cycle:
    """Work that the wire process repeats in a thread of its own, on absolute deadlines, missed ones skipped.

    run(now_s): one round; now_s is time.monotonic() at its begin. It may wait for answers, up to its period. Each
    round that sends asks `outbox.at(time.monotonic())` right before, and sends that. What it raises is a fault of the
    wire: every joint is damped, latched; `run` goes on being called, so that what can still be damped is. phase_s: how
    much later than the others' its deadlines are.
    """

    name: str
    period_s: float
    run: Callable[[float], None]
    phase_s: float = 0.0


class Damper(Protocol):
    """Damps the devices of one bus, port or link, and can do nothing else. Picklable until `prepare`.

    It lives in the standby process, in a thread of its own; that calls `prepare` when devices are about to be switched
    on, and the rest only when the wire process is no more: `damp` every period_s, then `disable` once, then `close`.
    """

    name: str
    period_s: float

    def prepare(self) -> None:
        """Connect as far as can be done beside the wire process, which still owns the wire. Sends nothing."""
        ...

    def damp(self) -> Collection[str]:
        """One round: connect where that is still to be done, send damping. The joints that have been heard since.

        Raises DeviceError; it is called again all the same.
        """
        ...

    def disable(self) -> None:
        """Take the drive away. Nobody waits for an answer."""
        ...

    def close(self) -> None:
        """Let go."""
        ...


class Driver(Protocol):
    """Devices on wires. Nothing is sent that drives a joint before `enable()`.

    Order of calls: identify, dampers, start, then (while the cycles run) enable and acknowledge, at the end (the cycles
    have stopped) disable if `enable` was called, close always. All but `Cycle.run` are called by the main thread of the
    wire process; a driver guards by itself what it shares with its cycles.
    """

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints that it drives, in the robot's order."""
        ...

    def identify(self) -> DeviceInfo:
        """Connect, find and check the devices, set and read back their watchdogs. Energises nothing.

        Raises DeviceError (DeviceFault where a device answers and refuses), naming everything that is wrong.
        """
        ...

    def dampers(self) -> Sequence[Damper]:
        """What damps its devices from another process, once `identify` has returned."""
        ...

    def start(self, outbox: Outbox, state: StateBoard) -> Sequence[Cycle]:
        """The cyclic work. From here on states arrive on the board, though the outbox says IDLE."""
        ...

    def enable(self) -> None:
        """Before the first command that is not IDLE goes out: enable every device, into damping.

        The outbox says IDLE until this has returned or raised. It may take long. What it raises is a latched fault;
        the devices that are enabled are damped then.
        """
        ...

    def disable(self) -> None:
        """After damping, when the cycles have stopped: take the drive away. One silent device hinders no other."""
        ...

    def acknowledge(self) -> None:
        """The operator's word after a latched fault: clear the devices' faults, into damping. Never automatic."""
        ...

    def close(self) -> None:
        """Let go of the wire. Called once, also where `identify` has raised."""
        ...


@runtime_checkable
class HandsBack(Protocol):
    """A driver of a robot that has a controller of its own."""

    def hand_back(self) -> str:
        """After `disable`, with all joints at rest: the robot's own controller drives it again. In words, what does.

        Raises DeviceError where it does not.
        """
        ...


DriverFactory = Callable[[Robot], Driver]
"""What builds the driver, picklable."""


@dataclass(frozen=True)
class WireFactory:
    """What a driver's module offers by `make_factory(config, endpoints)`, see hal/open.py: a DriverFactory.

    driver: a class or function of a module, called with the robot and `options`, which can be pickled; raises
    InputError where they do not fit. wires: names of what it locks. link_timeout_s: how long everything may be silent.
    """

    driver: Callable[[Robot, Any], Driver]
    options: Any
    wires: tuple[str, ...] = ()
    link_timeout_s: float = LINK_TIMEOUT_S

    def __call__(self, robot: Robot) -> Driver:
        """The driver, where the wire is owned."""
        return self.driver(robot, self.options)
