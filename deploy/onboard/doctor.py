"""The command `deploy/doctor`: is this computer fit to run a robot, and what is to be done where it is not."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from core.arguments import ArgumentParser, path_argument, positive_argument
from core.clock import MonotonicClock
from core.config import config_file, load_options
from core.errors import InputError
from deploy.onboard.computer import Computer, Row, Wanted
from hal.realtime import no_garbage_collection, realtime

FIT, BAD_INPUT, NOT_FIT, STOPPED = 0, 2, 4, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row for everything that is checked. Exit code 0 where all is well, 4 where not, 2 on bad input."""
    parser = ArgumentParser(prog="deploy/doctor", description=__doc__, allow_abbrev=False)
    parser.add_argument("--config", default="doctor", metavar="NAME|FILE", help="what is wanted, see configs/onboard")
    parser.add_argument("--seconds", type=positive_argument, metavar="S", help="how long waking up is measured")
    parser.add_argument("--root", type=path_argument, default=Path("/"), metavar="DIR", help="another computer's files")
    try:
        given = parser.parse_args(arguments)
        wanted = load_options(Wanted, config_file("onboard", given.config))
        if not (given.root / "proc").is_dir():
            raise InputError("no /proc below it", where=f"--root {given.root}")
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return BAD_INPUT
    try:
        rows = list(Computer(given.root, wanted).rows())
        if given.root == Path("/"):
            rows.append(wake_up(late_us(given.seconds or wanted.wake_up_s, wanted.wake_up_period_s), wanted))
    except KeyboardInterrupt:
        print("stopped before the end", file=sys.stderr)
        return STOPPED
    print("\n".join(lines(rows)), flush=True)
    return FIT if all(row.good for row in rows) else NOT_FIT


def lines(rows: Sequence[Row]) -> list[str]:
    """A line each, and below it what to do where it is not good."""
    what, found = max(len(row.what) for row in rows), max(len(row.found) for row in rows)
    table = []
    for row in rows:
        table.append(f"  {'ok' if row.good else 'NO':2}  {row.what:{what}}  {row.found:{found}}  wanted: {row.wanted}")
        table += [] if row.good else [f"      {'':{what}}  do: {row.remedy}"]
    bad = sum(not row.good for row in rows)
    return [*table, f"{len(rows) - bad} of {len(rows)} in order"]


def late_us(seconds: float, period_s: float, say: Callable[[str], None] = lambda line: None) -> np.ndarray:
    """How late a thread with the loop's scheduling wakes up from each of its naps, in microseconds."""
    clock = MonotonicClock()
    late_s = np.zeros(max(1, round(seconds / period_s)))
    with realtime(say), no_garbage_collection():
        start_s = clock.now_s()
        for nap in range(late_s.size):
            due_s = max(start_s + nap * period_s, clock.now_s() + 0.5 * period_s)
            clock.sleep_until(due_s)
            late_s[nap] = clock.now_s() - due_s
    return 1e6 * late_s


def wake_up(late_us: np.ndarray, wanted: Wanted) -> Row:
    """The verdict on what was measured."""
    p99_us, most_us = float(np.percentile(late_us, 99.0)), float(late_us.max())
    good = p99_us <= wanted.wake_up_p99_us and most_us <= wanted.wake_up_max_us
    found = f"p99 {p99_us:.0f} us, max {most_us:.0f} us"
    limits = f"p99 {wanted.wake_up_p99_us:.0f} us, max {wanted.wake_up_max_us:.0f} us"
    remedy = "mend the rows above, stop other programs, switch off power saving in the firmware (C states, SMI)"
    return Row("wake-up", good, found, limits, remedy)
