"""Which Dynamixel servos answer on a port, at which baud rate; with the maker's own library."""

import contextlib
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

from core import robot_time as time
from core.arguments import ArgumentParser
from core.command import STOPPED
from hal.calibration.consent import DEVICE, DONE, run_command
from hal.contract.types import DeviceError
from hal.dynamixel import registers as r
from hal.dynamixel.models import known_models
from hal.dynamixel.port import ServoPort, latency_timer_ms
from hal.wire.lock import WireLock, wire_name

PROTOCOL = 2.0
READ_TIMEOUT_S = 0.001
TRIES = 20
LISTEN_S, LISTEN_BAUD = 0.3, 1_000_000


@dataclass(frozen=True)
class Answered:
    """One servo that answered a ping."""

    baud: int
    id: int
    model: str
    firmware: int


def scan(device: str, bauds: Sequence[int]) -> list[Answered]:
    """Listen, then ping everybody at each baud rate; about a second each.

    Raises DeviceError where the port cannot be used, or somebody commands its servos.
    """
    names = {model.number: model.name for model in known_models().values()}
    found = []
    with _opened(device) as port:
        for baud in bauds:
            _set_baud(port, baud)
            answers, _ = PacketHandler(PROTOCOL).broadcastPing(port)
            for servo_id, (number, firmware) in sorted(answers.items()):
                found.append(Answered(baud, servo_id, names.get(number, f"model number {number}"), firmware))
    return found


def torque_off(device: str, baud: int, ids: Sequence[int]) -> list[int]:
    """Take the torque off. The ids that did not confirm it. Raises DeviceError where the port cannot be used."""
    handler = PacketHandler(PROTOCOL)
    with _opened(device) as port:
        _set_baud(port, baud)
        left = list(ids)
        for _ in range(TRIES):
            written = {i: handler.write1ByteTxRx(port, i, r.TORQUE_ENABLE.address, 0) for i in left}
            left = [servo_id for servo_id, (result, _) in written.items() if result != COMM_SUCCESS]
    return left


def main(arguments: Sequence[str] | None = None) -> int:
    """The command `hal/scan_dynamixel`.

    Returns 0 done, 2 bad input, 130 stopped, 4 where nothing answers, a servo keeps its torque, or the port cannot be
    used.
    """
    return run_command(lambda: _scan(_parser().parse_args(arguments)), STOPPED)


def _scan(given: Namespace) -> int:
    found = scan(given.port, given.baud)
    for servo in found:
        print(f"{servo.baud:>8} baud  id {servo.id:>3}  {servo.model}, firmware {servo.firmware}")
    if (latency_ms := latency_timer_ms(given.port)) is not None:
        print(f"latency timer of {given.port}: {latency_ms} ms")
    if not found:
        raise DeviceError(f"nothing answers on {given.port}")
    failed = []
    if given.torque_off:
        for baud in sorted({servo.baud for servo in found}):
            failed += torque_off(given.port, baud, [servo.id for servo in found if servo.baud == baud])
        print("torque off" + (f", not confirmed by {failed}" if failed else ""))
    return DEVICE if failed else DONE


@contextmanager
def _opened(device: str) -> Iterator[PortHandler]:
    """The port, for this program alone, and only where nobody speaks on it."""
    port = PortHandler(device)
    with WireLock((wire_name("serial", device),)), contextlib.closing(ServoPort(device, LISTEN_BAUD)) as quiet:
        quiet.open()
        if heard := quiet.receive(time.monotonic() + LISTEN_S):
            raise DeviceError(
                f"{device}: {len(heard)} bytes came though nothing was asked: somebody commands its servos"
            )
        quiet.close()
        try:
            port.openPort()
        except OSError as error:
            raise DeviceError(f"cannot open {device}: {error}") from error
        try:
            yield port
        finally:
            port.closePort()


def _set_baud(port: PortHandler, baud: int) -> None:
    if not port.setBaudRate(baud):
        raise DeviceError(f"{port.getPortName()}: dynamixel-sdk cannot set {baud} baud")
    port.ser.timeout = READ_TIMEOUT_S  # the library polls its port; this lets it sleep meanwhile


def _parser() -> ArgumentParser:
    bauds = [baud for baud in r.BAUDS if baud != 4_500_000]
    parser = ArgumentParser(
        prog="hal/scan_dynamixel",
        description="List the Dynamixel servos that answer on a serial port.",
        epilog="Exit codes: 0 done, 2 bad input, 4 nothing answers or the port cannot be used, 130 stopped.",
        allow_abbrev=False,
    )
    parser.add_argument("port", metavar="DEVICE", help="such as /dev/ttyUSB0")
    parser.add_argument("--baud", type=int, nargs="+", choices=bauds, default=[57600, *bauds[3:]], metavar="N")
    parser.add_argument("--torque-off", action="store_true", help="let go of every servo found: support the robot")
    return parser
