"""Damping at the far end of the wire, whatever becomes of the loop: seen by the emulator, motor by motor."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hal.open import WIRES
from tests.hal.conformance.loop_process import EARNEST, PATIENT
from tests.hal.conformance.rigs import Emulators, wait_until
from tests.hal.rigs import PERIOD_S

pytestmark = pytest.mark.real_time

ROOT = Path(__file__).resolve().parents[3]
ATTEMPTS = 2


class LoopOnWire:
    """The loop's process and the emulator at the other end of its wire."""

    def __init__(self, wire: str, running: Emulators) -> None:
        config = running.config(wire)
        self.emulator = running.get(wire, config)
        period_s = PERIOD_S * running.factor
        self.deadline_s = 4.0 * period_s  # 3 control periods and one cycle of the wire
        self.standby_s = 10.0 * period_s
        self._call = [sys.executable, "-m", "tests.hal.conformance.loop_process", wire, str(config), str(period_s)]

    def start(self, end: str = "never") -> subprocess.Popen[str]:
        """A loop that drives every motor. Opening asks each of them in turn, so a busy machine may need another try."""
        for _ in range(ATTEMPTS):
            self._launch(end)
            if self._opened():
                break
            self.stop()
        assert self.process.poll() is None, self.complaint
        self.is_driven()
        return self.process

    def is_driven(self) -> None:
        """The loop acknowledges until all motors are driven, and nothing more from then on."""
        self._tell(PATIENT)
        wait_until(lambda: self.modes() == {"driven"}, 20.0)
        self._tell(EARNEST)

    def _tell(self, word: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()

    def _launch(self, end: str) -> None:
        call = [*self._call, json.dumps(self.emulator.endpoints), end]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(call, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def _opened(self) -> bool:
        assert self.process.stdout is not None and self.process.stderr is not None
        opened = self.process.stdout.readline() == "open\n"
        self.complaint = "" if opened else self.process.stderr.read()
        return opened

    def wire_process(self) -> int:
        """The only child of the loop's."""
        (pid,) = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return int(pid)

    def modes(self) -> set[str]:
        return set(self.emulator.control.status()["mode"].values())

    def damped_after_s(self, since_s: float) -> float:
        """When the last motor was told to damp, after since_s."""
        status = wait_until(lambda: (s := self.emulator.control.status())["mode"] and self._all(s, "damped") and s)
        return max(status["mode_since_s"].values()) - since_s

    def stop(self) -> None:
        """Until the wire process has damped to rest as well: the next loop would be refused beside it."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        with contextlib.suppress(AssertionError):
            wait_until(lambda: self.modes() == {"slack"}, 6.0)
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()

    @staticmethod
    def _all(status: dict, mode: str) -> bool:
        return set(status["mode"].values()) == {mode}


@pytest.fixture(scope="module", params=WIRES)
def wire(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def loop(wire: str, running: Emulators) -> Iterator[LoopOnWire]:
    made = LoopOnWire(wire, running)
    yield made
    made.stop()


@pytest.mark.always
def test_a_frozen_loop_stays_damped_when_it_thaws_and_a_killed_one_ends_slack(loop: LoopOnWire, grace_s: float) -> None:
    """In between it acknowledges, and drives again."""
    process = loop.start()
    process.send_signal(signal.SIGSTOP)
    frozen_s = time.monotonic()
    assert loop.damped_after_s(frozen_s) < loop.deadline_s + grace_s
    process.send_signal(signal.SIGCONT)
    time.sleep(0.3)
    assert loop.modes() == {"damped"}
    loop.is_driven()
    process.kill()
    killed_s = time.monotonic()
    assert loop.damped_after_s(killed_s) < loop.deadline_s + grace_s
    wait_until(lambda: loop.modes() == {"slack"})


@pytest.mark.always({"dds": "close", "can": "raise", "dynamixel": "close"})
@pytest.mark.parametrize("end", ["raise", "close"])
def test_an_end_of_the_loop_damps_first_and_disables_then(loop: LoopOnWire, end: str, grace_s: float) -> None:
    process = loop.start(end)
    assert process.stdout is not None
    ended_s = float(process.stdout.readline())
    assert loop.damped_after_s(ended_s) < loop.deadline_s + grace_s
    assert process.wait(10) == (1 if end == "raise" else 0)
    assert loop.modes() == {"slack"}


STRUCK = {
    "wire killed": (signal.SIGKILL, ("wire",)),
    "both stopped": (signal.SIGSTOP, ("loop", "wire")),
    "wire stopped": (signal.SIGSTOP, ("wire",)),
    "both killed": (signal.SIGKILL, ("loop", "wire")),
}


@pytest.mark.always({"dds": "wire killed", "can": "both stopped", "dynamixel": "both stopped"})
@pytest.mark.parametrize("how", STRUCK)
def test_a_wire_process_that_is_no_more_is_damped_for(loop: LoopOnWire, how: str, grace_s: float) -> None:
    """Its standby takes the wire, and lets go of it at the end. All cases and states: benchmarks/exits.py."""
    number, struck = STRUCK[how]
    process = loop.start()
    pids = {"loop": process.pid, "wire": loop.wire_process()}
    struck_s = time.monotonic()
    for name in struck:
        os.kill(pids[name], number)
    assert loop.damped_after_s(struck_s) < loop.standby_s + grace_s
    if how == "wire killed":
        assert process.wait(20) == 1
        assert process.stderr is not None and "its standby has the wire" in process.stderr.read()
    process.kill()
    wait_until(lambda: loop.modes() == {"slack"})


def test_a_signal_ends_the_opening_of_a_lossy_wire_within_5_s() -> None:
    """Where most answers of servos are lost, opening takes half a minute."""
    command = [sys.executable, "-P", str(ROOT / "deploy" / "run"), "--backend", "dynamixel", "--emulate"]
    command += ["--policy", "taichi", "--fault", "drop=0.6"]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children")
    wait_until(lambda: len(children.read_text().split()) == 2, 60.0)  # the emulator and the wire process
    time.sleep(1.0)
    begun_s = time.monotonic()
    run.send_signal(signal.SIGTERM)
    out, _ = run.communicate(timeout=30)
    assert time.monotonic() - begun_s < 5.0
    assert run.returncode == 0 and "stopped before anything was commanded" in out
