"""The command `hal/scan`: what answers on the buses, and what the wires allow."""

import contextlib
import time
from collections.abc import Iterable, Sequence

from core.arguments import ArgumentParser
from core.command import STOPPED
from core.errors import InputError
from core.structured import one_of
from hal.calibration.consent import DEVICE, DONE, add_wire_options, load_wires, run_command
from hal.can.bus_load import bus_loads, check_loads, load_table
from hal.can.codec import Codec, Found, MotorCommand
from hal.can.codecs import CODECS
from hal.can.frame import Frame
from hal.can.link import CanLink
from hal.can.robot_file import BusEntry, RobotFile
from hal.contract.types import DeviceError
from hal.wire.lock import WireLock

BEFORE_S, AFTER_S = 0.3, 0.15
ANSWER_S = 0.008
HOST_IDS = {"robstride": 0xFD, "moteus": 0}
LAST_ID = 127
SHOWN_IDS = 4


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns 0 done, 2 bad input, 130 stopped, 4 where a bus does not open or a servo of the file does not answer."""
    return run_command(lambda: _scan(arguments), STOPPED)


def _scan(arguments: Sequence[str] | None) -> int:
    given = _parser().parse_args(arguments)
    codecs = [codec for name, codec in CODECS.items() if name in (given.codec or CODECS)]
    if not given.codec:
        codecs = [codec for codec in codecs if not codec.probe_stops]
    ids = _ids(given.ids)
    if given.interface is not None:
        bus = BusEntry("bus", given.interface, given.channel, given.bitrate, given.fd)
        _print_found(scan_bus(bus, codecs, ids), bus, None, codecs)
        return DONE
    file, _ = load_wires(given.config, given.at)
    if given.bus is not None:
        one_of("--bus", given.bus, [bus.name for bus in file.buses], "unknown bus")
    print(load_table(bus_loads(file)))
    check_loads(bus_loads(file))
    if given.load:
        return DONE
    missing = [
        joint
        for bus in file.buses
        if given.bus in (None, bus.name)
        for joint in _print_found(scan_bus(bus, codecs, ids, file), bus, file, codecs)
    ]
    return DEVICE if missing else DONE


def scan_bus(
    bus: BusEntry, codecs: Sequence[type[Codec]], ids: Iterable[int], file: RobotFile | None = None
) -> list[Found]:
    """Listen, then ask each id in each protocol. Energises nothing; a codec with `probe_stops` takes the drive away.

    file: names the joints of a bus that is refused. Raises DeviceError where the bus cannot be opened, where another
    program of this machine uses it, and where anybody speaks on it unasked: somebody commands its motors.
    """
    asked = [codec for codec in codecs if bus.fd or not codec.fd]
    rows = [] if file is None else file.motors_of(bus.name)
    # Without a file one protocol's message may be another one's command: a single protocol cannot be mistaken.
    own = {type(file.codecs[i]) for i in rows} if file is not None else set(codecs if len(codecs) == 1 else ())
    found: dict[tuple[str, int], Found] = {}
    link = CanLink(bus.name, bus.arguments)
    with WireLock((bus.wire,)), contextlib.closing(link):
        link.open()
        _refuse_strangers(bus, _listen(link, asked, BEFORE_S, found), own, file)
        for motor_id in ids:
            for codec in asked:
                link.send(codec.probe(motor_id, HOST_IDS.get(codec.name, 0)))
                _listen(link, asked, ANSWER_S, found)
        _listen(link, asked, AFTER_S, found)
    return sorted(found.values(), key=lambda one: (one.codec, one.motor_id))


def _refuse_strangers(bus: BusEntry, heard: Sequence[Frame], own: set[type[Codec]], file: RobotFile | None) -> None:
    """Motors answer; those of a few protocols also speak by themselves. All else means that somebody commands."""
    strange = [frame for frame in heard if not any(codec.speaks_unasked(frame) for codec in own)]
    if not strange:
        return
    rows = [] if file is None else file.motors_of(bus.name)
    commanded = [
        file.motors[i].joint
        for i in rows
        if file is not None and any(file.codecs[i].parse_command(frame, MotorCommand()) for frame in strange)
    ]
    ids = ", ".join(f"{number:#x}" for number in sorted({frame.arbitration_id for frame in strange})[:SHOWN_IDS])
    whom = ", ".join(commanded) or f"whoever listens to the ids {ids}"
    raise DeviceError(
        f"bus {bus.name}: somebody commands {whom}: {len(strange)} frames in {BEFORE_S:g} s though nothing was asked; "
        "end that program first (drives that speak by themselves: name their protocol alone with --codec)"
    )


def _listen(
    link: CanLink, codecs: Iterable[type[Codec]], duration_s: float, found: dict[tuple[str, int], Found]
) -> list[Frame]:
    until_s, heard = time.monotonic() + duration_s, []
    while (frame := link.receive(until_s)) is not None:
        heard.append(frame)
        for codec in codecs:
            if (one := codec.recognise(frame)) is not None:
                found.setdefault((one.codec, one.motor_id), one)
    return heard


def _print_found(
    found: Sequence[Found], bus: BusEntry, file: RobotFile | None, codecs: Sequence[type[Codec]]
) -> list[str]:
    """One line for each, and for each servo of the file that did not answer. The joints of the silent ones."""
    expected = {} if file is None else {(file.motors[i].codec, file.motors[i].id): i for i in file.motors_of(bus.name)}
    heard = {(one.codec, one.motor_id) for one in found}
    for one in found:
        row = expected.get((one.codec, one.motor_id))
        joint = "not in the file" if row is None or file is None else file.motors[row].joint
        details = ", ".join(f"{name} {value}" for name, value in one.details.items())
        print(f"{bus.name:<12}{one.codec:<11}{one.motor_id:>4}  {'' if file is None else joint:<28}{details}")
    if not found:
        print(f"{bus.name:<12}nothing answers")
    missing = [] if file is None else [file.motors[i] for key, i in expected.items() if key not in heard]
    asked = {codec.name for codec in codecs}
    for motor in missing:
        why = "silent" if motor.codec in asked else f"not asked without --codec {motor.codec}"
        print(f"{bus.name:<12}{why}: {motor.joint}")
    return [motor.joint for motor in missing if motor.codec in asked]


def _ids(text: str) -> range:
    first, _, last = text.partition("-")
    if not (first.isdecimal() and (last or first).isdecimal()) or not 1 <= int(first) <= int(last or first) <= LAST_ID:
        raise InputError("--ids", got=text, expected=f"FIRST-LAST within 1 to {LAST_ID}")
    return range(int(first), int(last or first) + 1)


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="hal/scan",
        description="List the CAN servos that answer, and how much of each wire's time the configured rate takes. "
        "A bus that somebody commands is refused.",
        epilog="Exit codes: 0 done, 2 bad input, 4 a bus cannot be opened or a servo of it is silent, 130 stopped.",
        allow_abbrev=False,
    )
    add_wire_options(parser)
    add = parser.add_argument
    add("--bus", metavar="NAME", help="only this bus of the file")
    add("--interface", metavar="IF", help="a bus without a file, in python-can's terms")
    add("--channel", default="can0", metavar="CH")
    add("--bitrate", type=int, default=1_000_000, metavar="BITS/S")
    add("--fd", action="store_true", help="a CAN-FD bus")
    add(
        "--codec",
        action="append",
        choices=list(CODECS),
        help="only this protocol; repeatable. cubemars: its question takes the drive away, so it is asked only here",
    )
    add("--ids", default="1-32", metavar="FIRST-LAST")
    add("--load", action="store_true", help="only the table of loads; opens nothing")
    return parser
