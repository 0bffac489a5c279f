"""The command `hal/emulate`: one device-side emulator until it is told to end."""

import argparse
import contextlib
import gc
import json
import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType

from core import robot_time as time
from core.arguments import ArgumentParser, count_argument, number_argument
from core.errors import InputError
from core.structured import parse
from hal import realtime
from hal.contract.types import DeviceError
from hal.emulator.device import DEVICES
from hal.emulator.emulation import Emulation
from hal.emulator.faults import COMMON_KINDS, parse_fault
from hal.emulator.keyboard import KEY_TABLE, FaultKeys
from robot.robot import load_robot
from world.scene import Scene

DONE, FAILED, BAD_INPUT, DEVICE = 0, 1, 2, 4
POLL_S = 0.02
# The wire process of a killed loop damps until the joints rest, which takes 3 s at most.
ORPHANED_S = 3.5
SWITCH_INTERVAL_S = 0.0005


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until SIGTERM, SIGINT, `quit` or the end of the starter. Returns 0 done, 1 broke, 2 input, 4 device."""
    try:
        return _run(_parser().parse_args(arguments))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return BAD_INPUT
    except (DeviceError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return DEVICE


def _run(given: argparse.Namespace) -> int:
    emulation = Emulation(
        given.kind,
        given.config,
        load_robot(given.robot),
        scene=_scene(given.scene),
        faults=[parse_fault(text) for text in given.fault],
        start_noise_rad=given.start_noise,
        seed=given.seed,
    )
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    stop = emulation.asked_to_quit

    def end(number: int, frame: FrameType | None) -> None:
        stop.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    # It stands for hardware, which is never late. Before any thread starts, also those of a wire's own library.
    scheduling = realtime.schedule(realtime.EMULATOR_PRIORITY, inherited=True)
    with emulation:
        gc.collect()
        gc.freeze()  # a collection over everything that was loaded would hold all answers back
        print(json.dumps({**emulation.ready(), "pid": os.getpid(), "scheduling": scheduling}), flush=True)
        if given.lifeline:
            threading.Thread(target=_watch_starter, args=(stop,), name="lifeline", daemon=True).start()
        _wait(emulation, keys=not given.lifeline and sys.stdin.isatty())
        if emulation.failure is not None:
            print(f"error: the emulator broke: {emulation.failure!r}", file=sys.stderr)
            return FAILED
    return DONE


def _scene(text: str) -> Scene:
    """Raises InputError where it is none."""
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InputError("not JSON", where="--scene", got=text, expected='such as {"floor_m": 0.4}') from error
    return parse(Scene, content, "--scene")


def _wait(emulation: Emulation, *, keys: bool) -> None:
    with contextlib.ExitStack() as stack:
        pressed = stack.enter_context(FaultKeys(emulation)) if keys else None
        while not emulation.asked_to_quit.is_set() and emulation.failure is None:
            if pressed is None:
                emulation.asked_to_quit.wait(POLL_S)
                continue
            for line in pressed.wait(POLL_S):
                print(line, file=sys.stderr)


def _watch_starter(stop: threading.Event) -> None:
    """Standard input ends with the process that holds its other end."""
    while os.read(0, 4096):
        pass
    time.sleep(ORPHANED_S)
    stop.set()


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="hal/emulate",
        description="Speak the device side of a wire, moved by one simulated robot on a gantry. Prints one "
        "line of JSON: where the wire and the control socket are.",
        epilog=f"Faults: {', '.join(COMMON_KINDS)}, and each device's own. Keys at a terminal: {KEY_TABLE}. "
        "Exit codes: 0 done, 1 broke, 2 bad input, 4 the wire cannot be opened.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("kind", choices=list(DEVICES))
    add("--config", metavar="NAME|FILE", help="the same as for the host's side, see configs/hal")
    add("--robot", default="g1_23dof", metavar="NAME|FILE")
    add("--scene", default="{}", metavar="JSON", help="the ground: floor_m; boxes of centre_m, half_size_m, yaw_rad")
    add("--fault", action="append", default=[], metavar="KIND[:KEY][=VALUE][@START[+DURATION]]", help="repeatable")
    add("--start-noise", type=number_argument, default=0.0, metavar="RAD", help="std added to each joint at the start")
    add("--seed", type=count_argument, default=0, metavar="S")
    add("--lifeline", action="store_true", help="end some seconds after standard input does")
    return parser
