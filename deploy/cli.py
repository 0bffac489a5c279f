"""The command `deploy/run`."""

import os
from collections.abc import Sequence
from pathlib import Path

from core.arguments import ArgumentParser, count_argument, number_argument, path_argument, positive_argument
from core.errors import InputError
from core.files import write_json
from deploy.episode import Start
from deploy.goals.option import SOURCES
from deploy.operator.buttons import BUTTON_TABLE
from deploy.operator.keys import KEY_TABLE, Stopped, StopSignals
from deploy.operator.voice import Voice
from deploy.options import RunOptions
from deploy.record.report import RunReport, summary
from deploy.session import run_session
from hal.contract.types import DeviceError
from hal.open import BACKENDS

DONE, FAILED, BAD_INPUT, TRIPPED, DEVICE = 0, 1, 2, 3, 4


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, say what happens, and return the exit code: 0 done, 1 gave up, 2 input, 3 safety trip, 4 device."""
    voice = Voice()
    code = _main(arguments, voice)
    if not voice.close():
        os._exit(code)  # the interpreter's end would wait for the console
    return code


def _main(arguments: Sequence[str] | None, voice: Voice) -> int:
    try:
        with StopSignals() as signals:
            options = parse(arguments)
            if options.peer != "robot":
                voice.label = "[peer simulator: checksum, mode_machine, tick and rate are not checked] "
            report = run_session(options, signals, voice)
    except Stopped:
        voice.say("stopped before anything was commanded")
        return DONE
    except InputError as error:
        voice.complain(f"error: {error}")
        return BAD_INPUT
    except DeviceError as error:
        voice.complain(f"error: {error}")
        return DEVICE
    except OSError as error:
        voice.complain(f"error: {error}")
        return FAILED
    written = options.json is None or _write(options.json, report, voice)
    voice.say("\n".join(summary(report)))
    return exit_code(report) or (DONE if written else FAILED)


def _write(path: Path, report: RunReport, voice: Voice) -> bool:
    """The result as JSON; a disk that refuses it changes nothing in how the run ended."""
    try:
        write_json(path, report.content)
    except OSError as error:
        voice.complain(f"error: {path} could not be written: {error.strerror}")
        return False
    return True


def exit_code(report: RunReport) -> int:
    """An operator's stop is an orderly end."""
    if report.outcome == "tripped":
        return TRIPPED
    return FAILED if report.gave_up else DONE


def parse(arguments: Sequence[str] | None = None) -> RunOptions:
    """Options from the command line. Raises InputError on bad usage."""
    given = vars(_parser().parse_args(arguments))
    several = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
    return RunOptions(**{**given, **several, "start": Start(given["start"])})


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="deploy/run",
        description="Run an actor on a robot or its simulation: stand up, play the motion once, stand, damp.",
        epilog=f"Keys with --interactive, and always on a real wire: {KEY_TABLE}. Remote and gamepad: "
        f"{BUTTON_TABLE}. Exit codes: 0 done or stopped, 1 gave up, 2 bad input, 3 safety trip, 4 device.",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("--backend", required=True, choices=BACKENDS)
    add(
        "--policy", required=True, action="append", dest="policies", metavar="NAME|FILE",
        help="repeat it to switch with --interactive",
    )  # fmt: skip
    add(
        "--motion", action="append", default=[], dest="motions", metavar="NAME|FILE",
        help="clip, folder of clips or manifest, for actors that carry none; repeat it to switch with --interactive",
    )  # fmt: skip
    add("--goal", metavar="SOURCE", help=f"for actors that follow goals: {SOURCES}; see docs/steering.md")
    add("--stand", default="stand", metavar="NAME|FILE", help="the actor that balances before and after")
    add("--robot", default="g1_23dof", metavar="NAME|FILE")
    add(
        "--config", default="default", dest="settings", metavar="NAME|FILE",
        help="thresholds and waits, see configs/deploy",
    )  # fmt: skip
    add("--interactive", action="store_true", help="wait for keys")
    _add_wire_options(parser)
    add("--sim", default="default", metavar="default|reference|FILE")
    add("--sim-model", type=path_argument, metavar="FILE", help="simulate this MJCF instead of the robot's own")
    add("--start", default="stand", choices=[start.value for start in Start])
    add(
        "--start-noise", type=number_argument, default=0.0, dest="start_noise_rad", metavar="RAD",
        help="std added to each joint at the start",
    )  # fmt: skip
    add("--duration", type=positive_argument, dest="duration_s", metavar="S", help="end in order after this long")
    _add_output_options(parser)
    return parser


def _add_output_options(parser: ArgumentParser) -> None:
    add = parser.add_argument
    pace = parser.add_mutually_exclusive_group()
    pace.add_argument("--realtime", action="store_true", default=None, help="default with a person watching")
    pace.add_argument("--fast", dest="realtime", action="store_false", help="default otherwise")
    add("--video", type=path_argument, metavar="F", help=".mp4 with what is asked as a ghost, or .png: a strip")
    add("--viewer", action="store_true", help="live window")
    add("--meshes", type=path_argument, metavar="DIR", help="the maker's STL files, shown in video and window")
    add("--log", type=path_argument, metavar="DIR", help="one MCAP file per run")
    add(
        "--status", type=count_argument, dest="status_port", metavar="PORT",
        help="status at http://127.0.0.1:PORT/ and /json; 0: any port",
    )  # fmt: skip
    add("--dry-run", action="store_true", help="preflight, then read and infer for some seconds; never write")
    add("--json", type=path_argument, metavar="F", help="the result")
    add("--seed", type=count_argument, default=0, metavar="S")


def _add_wire_options(parser: ArgumentParser) -> None:
    add = parser.add_argument
    add("--hal-config", metavar="NAME|FILE", help="the robot on its wires, see configs/hal")
    add("--emulate", action="store_true", help="start the wire's other end as well: a simulated robot, real frames")
    add(
        "--fault", action="append", default=[], dest="faults", metavar="FAULT",
        help="with --emulate, see hal/emulate --help",
    )  # fmt: skip
    add("--interface", metavar="IF", help="network interface of --backend dds")
    add("--domain", type=count_argument, metavar="N", help="DDS domain")
    add("--hand-back", action="store_true", help="dds: lowered and at rest, the robot's own controller has it again")
    add("--peer", default="robot", choices=["robot", "simulator"], help="simulator: the maker's, on loopback alone")
    add("--gamepad", type=path_argument, metavar="FILE", help="such as /dev/input/js0")
    add("--first-run-ok", action="store_true", help="on a real robot: start without a passed dry run and hal/verify")
