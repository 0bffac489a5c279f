"""Worker processes end with the one that started them, and it ends in one line where one of them does."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.sim2sim.toys import write_still_actor

ROOT = Path(__file__).resolve().parents[2]


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_for(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="looks processes up in /proc"),
    pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core: no worker processes"),
]


@pytest.fixture
def at_work(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """An evaluation of 200 episodes, the first of which are played."""
    actor = str(write_still_actor(tmp_path / "actor.onnx"))
    command = [sys.executable, "-P", str(ROOT / "sim2sim" / "evaluate"), "--policy", actor, "--episodes", "200"]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in a shell's background
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    signal.signal(signal.SIGINT, before)
    with process:
        try:
            wait_for(lambda: len(children(process.pid)) >= 3)  # two workers and the resource tracker
            assert process.stderr is not None
            assert process.stderr.read(8) == "episode "  # the workers are at work
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_of_a_killed_evaluation_end(at_work: subprocess.Popen[str], number: signal.Signals) -> None:
    workers = children(at_work.pid)
    at_work.send_signal(number)
    at_work.communicate()
    wait_for(lambda: not any(is_running(pid) for pid in workers))


def test_a_worker_that_is_killed_ends_the_evaluation_in_one_line(at_work: subprocess.Popen[str]) -> None:
    is_worker = [pid for pid in children(at_work.pid) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(is_worker[0], signal.SIGKILL)
    said = at_work.communicate()[1]
    assert at_work.returncode == 1 and "Traceback" not in said
    last = said.splitlines()[-1]
    assert re.fullmatch(r"error: a worker process ended \(out of memory\?\): got \d+ of 200 episodes", last)


def test_ctrl_c_ends_an_evaluation_at_once_however_often_it_comes(at_work: subprocess.Popen[str]) -> None:
    workers = children(at_work.pid)
    for _ in range(3):
        at_work.send_signal(signal.SIGINT)
    said = at_work.communicate(timeout=60.0)[1]
    assert at_work.returncode == 130 and "Traceback" not in said
    assert said.splitlines()[-1] == "stopped before the end"
    wait_for(lambda: not any(is_running(pid) for pid in workers))
