"""What the operator must say before anything moves, and how the commands end."""

import signal
import sys
from argparse import ArgumentParser
from collections.abc import Callable
from types import FrameType

from core.errors import InputError
from hal.can.robot_file import DEFAULT_CONFIG, RobotFile, load_robot_file
from hal.contract.types import DeviceError
from robot.robot import Robot, load_robot

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
    pairs = [text.partition("=") for text in elsewhere]
    if wrong := [text for text, (_, separator, _) in zip(elsewhere, pairs) if not separator]:
        raise InputError("--at", got=wrong[0], expected="BUS=ENDPOINT")
    file = load_robot_file(config).at({bus: endpoint for bus, _, endpoint in pairs})
    return file, load_robot(file.robot)


def run_command(action: Callable[[], int]) -> int:
    """Run a command's body; its errors become one line and an exit code. SIGTERM ends it like Ctrl-C."""
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        return action()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return BAD_INPUT
    except (DeviceError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return DEVICE
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return DONE
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
