"""What the operator must say before anything moves, and how the commands end."""

import contextlib
import signal
import sys
import threading
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from types import FrameType

from core.errors import InputError
from hal.can.robot_file import DEFAULT_CONFIG, RobotFile, load_robot_file
from hal.contract.types import DeviceError
from robot.robot import Robot, load_robot

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
DONE, FAILED, BAD_INPUT, DEVICE = 0, 1, 2, 4
Ask = Callable[[str], str]


def consent(joint: str, what: str, ask: Ask | None) -> None:
    """Say what is about to happen and let the operator type the joint's name. Raises InputError on anything else.

    ask: how to ask; None: at the terminal, without which there is no consent.
    """
    print(what, flush=True)
    if ask is None:
        if not sys.stdin.isatty():
            raise InputError("needs a terminal: somebody must stand by and agree", where=joint)
        ask = input
    answer = ask(f"type {joint} to go on: ").strip()
    if answer != joint:
        raise InputError("not agreed, nothing was moved", where=joint, got=repr(answer))


def add_wire_options(parser: ArgumentParser) -> None:
    """The options that say which robot and where."""
    parser.add_argument("--config", default=DEFAULT_CONFIG, metavar="NAME|FILE", help="the robot file, see configs/hal")
    parser.add_argument(
        "--at",
        action="append",
        default=[],
        metavar="BUS=ENDPOINT",
        help="a bus elsewhere, e.g. what hal/emulate prints; repeatable",
    )


def load_wires(config: str, elsewhere: list[str]) -> tuple[RobotFile, Robot]:
    """The robot file with its buses moved, and its robot."""
    file = load_robot_file(config).at(endpoints_of(elsewhere))
    return file, load_robot(file.robot)


def endpoints_of(elsewhere: list[str]) -> dict[str, str]:
    """What follows each --at: where a bus or port is instead. Raises InputError."""
    pairs = [text.partition("=") for text in elsewhere]
    if wrong := [text for text, (_, separator, _) in zip(elsewhere, pairs) if not separator]:
        raise InputError("--at", got=wrong[0], expected="BUS=ENDPOINT")
    return {bus: endpoint for bus, _, endpoint in pairs}


def run_command(action: Callable[[], int], stopped: int = DONE) -> int:
    """Run a command's body; its errors become one line and an exit code. Every stop signal ends it like Ctrl-C.

    stopped: what it ends with then. To stop is an orderly end of what moves a robot, and of nothing else.

    What is on its way out is not interrupted a second time, and a console that is gone keeps nobody.
    """
    before = {number: signal.signal(number, _interrupt) for number in STOP_SIGNALS}
    try:
        return action()
    except InputError as error:
        return _end(f"error: {error}", BAD_INPUT)
    except (DeviceError, OSError) as error:
        return _end(f"error: {error}", DEVICE)
    except KeyboardInterrupt:
        return _end("stopped", stopped)
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Within, stop signals wait until the end. Only the main thread hears them, so it alone has to hold them back."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {number: signal.signal(number, lambda number, _: came.append(number)) for number in STOP_SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        if came:
            signal.raise_signal(came[0])


def _end(line: str, code: int) -> int:
    with contextlib.suppress(OSError):
        print(line, file=sys.stderr, flush=True)
    return code


def _interrupt(number: int, frame: FrameType | None) -> None:
    for other in STOP_SIGNALS:
        signal.signal(other, signal.SIG_IGN)
    raise KeyboardInterrupt
