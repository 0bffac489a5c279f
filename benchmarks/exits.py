#!/usr/bin/env -S python3 -P
"""Kills and stops the loop, the wire process and both, in every state, on every wire: how long until all is damped.

The emulator judges: the time from the signal until its last motor was told to damp for good, in the robot's seconds,
which last longer where the machine cannot keep up. Each trial is a robot on its gantry; the loop is patient with late
states, so that a busy machine does not end a trial before its signal.
"""

import argparse
import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from core import robot_time as time
from core.arguments import ArgumentParser
from core.clock import MonotonicClock
from core.command import guarded
from core.files import check_output_file, write_json
from deploy.actors import load_run
from deploy.cell import Cell
from deploy.control.modes import Mode, Request
from deploy.control.states import StateMachine
from deploy.operator.console import Console
from deploy.operator.keys import RequestSource
from deploy.operator.voice import Voice
from deploy.safety.rules import Fault
from deploy.settings import load_settings
from hal.emulator.control import ControlClient
from hal.emulator.launch import Emulator, launch_emulator
from hal.host_watch import HostWatch
from hal.open import open_backend, wire_config
from hal.realtime import realtime
from robot.robot import load_robot

ROOT = Path(__file__).resolve().parents[1]
WIRES = ("dds", "can", "dynamixel")
SIGNALS = {"kill -9": signal.SIGKILL, "SIGSTOP": signal.SIGSTOP}
STRUCK = {"loop": ("loop",), "wire": ("wire",), "both": ("loop", "wire")}
# state -> what is asked for on the way there, each with the line that announces what it leads to
READY, TRACKING = ("stand", "READY"), ("start", "TRACKING")
STATES = {
    "STAND_UP": (("stand", "STAND_UP"),),
    "FIXED_STAND": (("stand", "FIXED_STAND"),),
    "READY": (READY,),
    "TRACKING": (READY, TRACKING),
    "HOLD": (READY, TRACKING, ("hold", "HOLD")),
    "LOWERING": (READY, ("finish", "LOWERING")),
    "BRACING": (("stand", "BRACING"),),
    "DAMPING": (READY, TRACKING, ("damp", "damping")),
}
BOUND_S = 0.2
JUDGED_AFTER_S = 0.4
DRIVES_S = 0.5
TRIES = 4
PATIENT_PERIODS = 50.0
PATIENCE_S = 30.0
END_S = 15.0


class Words:
    """Requests that the trial writes to standard input, one a line."""

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        os.set_blocking(0, False)
        with contextlib.suppress(BlockingIOError):
            return [Request(word) for word in os.read(0, 1024).decode().split()]
        return ()


class Falls:
    """No robot falls on its gantry. This one is taken for falling as soon as it is balanced."""

    def __init__(self, machine: StateMachine) -> None:
        self._machine = machine

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        if self._machine.mode is Mode.READY:
            self._machine.trip(Fault("tilt", "as if it fell"))
        return ()


class ElsewhereLaunched(Emulator):
    """The emulator of the process that strikes: what a loop needs of it."""

    def __init__(self, endpoints: Mapping[str, str], control: str) -> None:
        self.endpoints, self.control = dict(endpoints), ControlClient(control)


def loop(wire: str, emulator: Emulator, state: str) -> None:
    """What is struck, on the way to a state: the loop of deploy/run on an emulator that is there already. First it
    says its pace."""
    robot, settings, clock = load_robot(), load_settings(), MonotonicClock()
    safety = settings.safety
    stale = replace(safety.stale, limit_periods=PATIENT_PERIODS, trip_periods=PATIENT_PERIODS)
    overrun = replace(safety.inference_overrun, periods=PATIENT_PERIODS)
    settings = replace(settings, safety=replace(safety, stale=stale, inference_overrun=overrun))
    if settings.bracing is not None:  # as long as may be: it must still last when it is struck
        settings = replace(settings, bracing=replace(settings.bracing, lands_s=2.0))
    actors = [load_run(name, None, robot, settings.entry) for name in ("taichi", "stand")]
    cell = Cell(robot, settings, actors[:1], actors[1], fixed_stand=state == "FIXED_STAND")
    with open_backend(wire, robot, clock, emulator=emulator) as backend, realtime(lambda _: None):
        print(json.dumps(time.pace()), flush=True)
        time.sleep(DRIVES_S)
        console = Console(Voice(), backend, clock, refusals=False)
        print("IDLE", flush=True)
        operators: list[RequestSource] = [Words(), *([Falls(cell.machine)] if state == "BRACING" else [])]
        cell.loop(backend, clock, plan=None, operators=operators, observers=[console]).run()


@contextlib.contextmanager
def started(wire: str, emulator: Emulator, state: str) -> Iterator["subprocess.Popen[str]"]:
    """The loop's process, whose pace is this one's too; at the end nothing of it is left."""
    there = (json.dumps(emulator.endpoints), emulator.control.address, state)
    command = [sys.executable, "-P", __file__, "--loop", wire, *there]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        if pace := process.stdout.readline():
            time.follow(time.Pace(*json.loads(pace)))
        yield process
    finally:
        process.kill()
        process.communicate()
        end_s = time.monotonic() + END_S
        while set(emulator.control.status()["mode"].values()) != {"slack"} and time.monotonic() < end_s:
            time.sleep(0.05)
        time.follow(time.Pace())


def trial(wire: str, emulator: Emulator, number: signal.Signals, struck: Sequence[str], state: str) -> float | None:
    """Seconds until every motor was damped for good; inf where one was not; None where the state was not reached."""
    with started(wire, emulator, state) as process:
        if not _reached(process, state):
            return None
        time.sleep(DRIVES_S)
        (wire_process,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        pids = {"loop": process.pid, "wire": int(wire_process)}
        expected = "damped" if state == "DAMPING" else "driven"
        if expected not in emulator.control.status()["mode"].values():
            return None
        struck_s = time.monotonic()
        for name in struck:
            os.kill(pids[name], number)
        time.sleep(JUDGED_AFTER_S)
        status = emulator.control.status()
        if set(status["mode"].values()) != {"damped"}:
            return float("inf")
        return max(0.0, max(status["mode_since_s"].values()) - struck_s)


def _reached(process: "subprocess.Popen[str]", state: str) -> bool:
    """Ask for what leads to a state, one after the other. A loop that does not get there is killed."""
    assert process.stdin is not None
    patience = threading.Timer(time.machine_s(PATIENCE_S), process.kill)
    patience.start()
    try:
        there = _heard(process, "IDLE")
        for word, announced in STATES[state]:
            if not there:
                break
            process.stdin.write(f"{word}\n")
            process.stdin.flush()
            there = _heard(process, announced)
        return there
    finally:
        patience.cancel()


def _heard(process: "subprocess.Popen[str]", line: str) -> bool:
    """Whether the loop has come to announce a state."""
    assert process.stdout is not None
    return any(heard.strip() == line for heard in iter(process.stdout.readline, ""))


def trials(host: HostWatch, wires: Sequence[str], states: Sequence[str]) -> Iterator[tuple[str, float | None]]:
    """Every trial by its name. One that the state was not reached for, or the host paused in, is tried again."""
    for wire in wires:
        for (how, number), (to, struck), state in itertools.product(SIGNALS.items(), STRUCK.items(), states):
            for _ in range(TRIES):
                begun_s = time.monotonic()
                with launch_emulator(wire, wire_config(wire)) as emulator:
                    value_s = trial(wire, emulator, number, struck, state)
                if value_s is not None and (value_s <= BOUND_S or not host.longest_s(begun_s)):
                    break
            print(f"{wire:10} {how:8} {to:5} {state:11} {_cell(value_s):>11}", flush=True)
            yield f"{wire}, {how}, {to}, {state}", value_s


def table(found: Mapping[str, float | None]) -> list[str]:
    """Milliseconds, for a page."""
    rows = ["| wire | signal | to | " + " | ".join(STATES) + " |", "|---" * (3 + len(STATES)) + "|"]
    for key in dict.fromkeys(key.rpartition(", ")[0] for key in found):
        cells = [_cell(found[f"{key}, {state}"]) for state in STATES]
        rows.append("| " + " | ".join([*key.split(", "), *cells]) + " |")
    return rows


def _cell(value_s: float | None) -> str:
    return "not reached" if value_s is None else "never" if value_s == float("inf") else f"{1e3 * value_s:.0f}"


@guarded
def main() -> int:
    """Print the table of ms and, on request, write it as JSON. Returns 0 only if every trial is within 0.2 s."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--wire", action="append", choices=WIRES, help="repeatable; all of them")
    parser.add_argument("--state", action="append", choices=tuple(STATES), help="repeatable; all of them")
    parser.add_argument("--json", type=Path, metavar="F")
    parser.add_argument("--loop", nargs=4, metavar=("WIRE", "ENDPOINTS", "CONTROL", "STATE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.loop:
        wire, endpoints, control, state = options.loop
        loop(wire, ElsewhereLaunched(json.loads(endpoints), control), state)
        return 0
    check_output_file("--json", options.json)
    with contextlib.closing(HostWatch()) as host:
        found = dict(trials(host, options.wire or WIRES, options.state or tuple(STATES)))
    if not options.state:
        print(*table(found), sep="\n")
    if options.json:
        write_json(options.json, {key: _cell(value_s) for key, value_s in found.items()})
    return 0 if all(value_s is not None and value_s <= BOUND_S for value_s in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
