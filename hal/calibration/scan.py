"""The command `hal/scan`: what answers on the buses, and what the wires allow."""

import time
from collections.abc import Iterable, Sequence

from core.arguments import ArgumentParser
from core.errors import InputError
from hal.calibration.consent import DEVICE, DONE, add_wire_options, load_wires, run_command
from hal.can.bus_load import bus_loads, check_loads, load_table
from hal.can.codec import Codec, Found
from hal.can.codecs import CODECS
from hal.can.link import CanLink
from hal.can.robot_file import BusEntry, RobotFile

LISTEN_S = 0.15
ANSWER_S = 0.008
HOST_IDS = {"robstride": 0xFD, "moteus": 0}
LAST_ID = 127


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns 0 done, 2 bad input, 4 where a bus cannot be opened or a servo of the file does not answer."""
    return run_command(lambda: _scan(arguments))


def _scan(arguments: Sequence[str] | None) -> int:
    given = _parser().parse_args(arguments)
    codecs = [CODECS[name] for name in given.codec or CODECS]
    ids = _ids(given.ids)
    if given.interface is not None:
        bus = BusEntry("bus", given.interface, given.channel, given.bitrate, given.fd)
        _print_found(scan_bus(bus, codecs, ids), bus, None)
        return DONE
    file, _ = load_wires(given.config, given.at)
    print(load_table(bus_loads(file)))
    check_loads(bus_loads(file))
    if given.load:
        return DONE
    missing = [
        joint
        for bus in file.buses
        if given.bus in (None, bus.name)
        for joint in _print_found(scan_bus(bus, codecs, ids), bus, file)
    ]
    return DEVICE if missing else DONE


def scan_bus(bus: BusEntry, codecs: Iterable[type[Codec]], ids: Iterable[int]) -> list[Found]:
    """Listen, then ask each id in each protocol. Energises nothing; two protocols ask by repeating the switching off.

    Raises DeviceError where the bus cannot be opened.
    """
    asked = [codec for codec in codecs if bus.fd or not codec.fd]
    found: dict[tuple[str, int], Found] = {}
    link = CanLink(bus.name, bus.arguments)
    link.open()
    try:
        _listen(link, asked, LISTEN_S, found)
        for motor_id in ids:
            for codec in asked:
                link.send(codec.probe(motor_id, HOST_IDS.get(codec.name, 0)))
                _listen(link, asked, ANSWER_S, found)
        _listen(link, asked, LISTEN_S, found)
    finally:
        link.close()
    return sorted(found.values(), key=lambda one: (one.codec, one.motor_id))


def _listen(
    link: CanLink, codecs: Iterable[type[Codec]], duration_s: float, found: dict[tuple[str, int], Found]
) -> None:
    until_s = time.monotonic() + duration_s
    while (frame := link.receive(until_s)) is not None:
        for codec in codecs:
            if (one := codec.recognise(frame)) is not None:
                found.setdefault((one.codec, one.motor_id), one)


def _print_found(found: Sequence[Found], bus: BusEntry, file: RobotFile | None) -> list[str]:
    """One line for each, and for each servo of the file that is silent: their joints are returned."""
    expected = {} if file is None else {(file.motors[i].codec, file.motors[i].id): i for i in file.motors_of(bus.name)}
    heard = {(one.codec, one.motor_id) for one in found}
    for one in found:
        row = expected.get((one.codec, one.motor_id))
        joint = "not in the file" if row is None or file is None else file.motors[row].joint
        details = ", ".join(f"{name} {value}" for name, value in one.details.items())
        print(f"{bus.name:<12}{one.codec:<11}{one.motor_id:>4}  {'' if file is None else joint:<28}{details}")
    if not found:
        print(f"{bus.name:<12}nothing answers")
    missing = [] if file is None else [file.motors[i].joint for key, i in expected.items() if key not in heard]
    for joint in missing:
        print(f"{bus.name:<12}silent: {joint}")
    return missing


def _ids(text: str) -> range:
    first, _, last = text.partition("-")
    if not (first.isdecimal() and (last or first).isdecimal()) or not 1 <= int(first) <= int(last or first) <= LAST_ID:
        raise InputError("--ids", got=text, expected=f"FIRST-LAST within 1 to {LAST_ID}")
    return range(int(first), int(last or first) + 1)


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="hal/scan",
        description="List the CAN servos that answer, and how much of each wire's time the configured rate takes. "
        "Let nothing else use the bus meanwhile.",
        epilog="Exit codes: 0 done, 2 bad input, 4 a bus cannot be opened or a servo of the file is silent.",
        allow_abbrev=False,
    )
    add_wire_options(parser)
    add = parser.add_argument
    add("--bus", metavar="NAME", help="only this bus of the file")
    add("--interface", metavar="IF", help="a bus without a file, in python-can's terms")
    add("--channel", default="can0", metavar="CH")
    add("--bitrate", type=int, default=1_000_000, metavar="BITS/S")
    add("--fd", action="store_true", help="a CAN-FD bus")
    add("--codec", action="append", choices=list(CODECS), help="only this protocol; repeatable")
    add("--ids", default="1-32", metavar="FIRST-LAST")
    add("--load", action="store_true", help="only the table of loads; opens nothing")
    return parser
