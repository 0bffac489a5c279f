"""The command `hal/verify`: whether joints, signs, zeros and IMU are what the files say, with a person who looks."""

import argparse
import time
from collections.abc import Sequence

from core.arguments import ArgumentParser, count_argument
from core.clock import MonotonicClock
from core.errors import InputError
from hal.calibration.consent import DONE, run_command
from hal.contract.backend import Backend
from hal.contract.types import DeviceError, LinkLost, NoState
from hal.open import WIRES, open_backend, wire_config_sha256
from hal.verification.operator import Terminal
from hal.verification.options import load_verify_options
from hal.verification.record import RECORDS, VerifiedRecord
from hal.verification.session import verify
from robot.robot import load_robot

PERIOD_S = 0.05
FIRST_STATE_S = 3.0
LOOK_S = 0.01


def main(arguments: Sequence[str] | None = None, *, operator: Terminal | None = None) -> int:
    """Returns 0 verified or stopped, 2 bad input or not agreed, 4 where the robot is another than its files say."""
    return run_command(lambda: _verify(_parser().parse_args(arguments), operator))


def _verify(given: argparse.Namespace, operator: Terminal | None) -> int:
    robot, options, clock = load_robot(given.robot), load_verify_options(given.options), MonotonicClock()
    operator = operator or Terminal(robot.joint_names)
    endpoints = _endpoints(given)
    wire = {"config": given.hal_config, "endpoints": endpoints}
    backend = open_backend(given.backend, robot, clock, control_period_s=PERIOD_S, **wire)
    sha256 = wire_config_sha256(given.backend, given.hal_config, endpoints)
    try:
        info = backend.open()
        _await_state(backend)
        verify(backend, robot, clock, operator, options)
    finally:
        backend.close()
    record = VerifiedRecord(sha256, robot.name, info.identities)
    print(f"verified, recorded {record.save(RECORDS, {'backend': given.backend, 'time': time.strftime('%FT%T%z')})}")
    if not info.identities:
        print("note: nothing here has a number of its own, so another robot with the same files cannot be told apart")
    return DONE


def _endpoints(given: argparse.Namespace) -> dict[str, str]:
    pairs = [text.partition("=") for text in given.at]
    if wrong := [text for text, (_, separator, _) in zip(given.at, pairs) if not separator]:
        raise InputError("--at", got=wrong[0], expected="NAME=ENDPOINT")
    network = {"interface": given.interface, "domain": None if given.domain is None else str(given.domain)}
    return {name: where for name, _, where in pairs} | {k: value for k, value in network.items() if value is not None}


def _await_state(backend: Backend) -> None:
    """The first complete state. Raises DeviceError where none comes."""
    end_s = time.monotonic() + FIRST_STATE_S
    while True:
        try:
            backend.read()
            return
        except (NoState, LinkLost) as error:
            if time.monotonic() > end_s:
                raise DeviceError(str(error)) from error
        time.sleep(LOOK_S)


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="hal/verify",
        description="Check a robot on its gantry against its files: every joint moves a little and you say what you"
        " saw, then you lean it forwards and to the left. deploy/run on a real wire wants it once for each robot.",
        epilog="Exit codes: 0 verified or stopped, 2 bad input or not agreed, 4 device, or not the robot described.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--backend", required=True, choices=list(WIRES))
    add("--robot", default="g1_23dof", metavar="NAME|FILE")
    add("--hal-config", metavar="NAME|FILE", help="the robot on its wires, see configs/hal")
    add(
        "--options", default="verify", metavar="NAME|FILE", help="how far and how hard it moves, see configs/hal/verify"
    )
    add("--interface", metavar="IF", help="network interface of --backend dds")
    add("--domain", type=count_argument, metavar="N", help="DDS domain")
    add("--at", action="append", default=[], metavar="NAME=ENDPOINT", help="a bus or port elsewhere: an emulator's")
    return parser
