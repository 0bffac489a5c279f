"""Worker processes end with the one that started them."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
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


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="looks processes up in /proc")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one core: no worker processes")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_of_a_killed_evaluation_end(tmp_path: Path, number: signal.Signals) -> None:
    actor = str(write_still_actor(tmp_path / "actor.onnx"))
    command = [sys.executable, "-P", str(ROOT / "sim2sim" / "evaluate"), "--policy", actor, "--episodes", "200"]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    wait_for(lambda: len(children(process.pid)) >= 3)  # two workers and the resource tracker
    assert process.stderr is not None
    assert process.stderr.read(8) == "episode "  # the workers are at work
    workers = children(process.pid)
    process.send_signal(number)
    process.communicate()
    wait_for(lambda: not any(is_running(pid) for pid in workers))
