"""A console that takes nothing and an operator who is lost, on every wire, through the very loop of a robot.

The far end judges: as long as somebody is there, every motor stays driven; then every motor is told to damp.
"""

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from core.clock import MonotonicClock
from deploy.actors import load_run
from deploy.control.loop import Loop
from deploy.control.modes import Request
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.operator.console import Console
from deploy.operator.presence import Presence
from deploy.operator.voice import Voice
from deploy.record.observers import Observers
from deploy.safety.guard import Guard
from hal.open import WIRES, wire_factory
from hal.wire.emulated import EmulatedWireBackend
from tests.deploy.operator.test_presence import Person
from tests.deploy.toys import SETTINGS, write_linear_actor
from tests.hal.conformance.rigs import Emulators, ready
from tests.hal.rigs import G1, hold

pytestmark = pytest.mark.real_time

PERIOD_S = 0.05
SETTLE_S, STALLED_S, DAMP_AFTER_S = 0.5, 1.0, 0.5
LATE_S = 0.5
ATTEMPTS = 3


class Story:
    """The console stalls, somebody types on; then the operator goes. A plan, so that it happens inside the loop."""

    failure: str | None = None

    def __init__(self, backend: EmulatedWireBackend, machine: StateMachine, voice: Voice, person: Person) -> None:
        self._control, self._machine, self._voice, self._person = backend.emulator.control, machine, voice, person
        self._begun_s = time.monotonic()
        self.while_stalled: set[str] = set()
        self.lost_s = self.damped_s = 0.0

    def requests(self, state: object) -> Sequence[Request]:
        now_s = time.monotonic()
        if self._machine.latched:
            self.damped_s = now_s
            return (Request.QUIT,)
        if now_s - self._begun_s > SETTLE_S:
            for _ in range(20):
                self._voice.say(1000 * "x")
        if not self.lost_s and now_s - self._begun_s > SETTLE_S + STALLED_S:
            self.while_stalled = set(self._control.status()["mode"].values())
            self._person.live = False
            self.lost_s = time.monotonic()
        return ()


@pytest.mark.parametrize("wire", WIRES)
def test_a_stalled_console_drops_nobody_and_a_lost_operator_is_answered(
    wire: str, running: Emulators, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, grace_s: float
) -> None:
    config = running.config(wire)
    actor = write_linear_actor(tmp_path / "still.onnx", seconds=60.0)
    read, write = os.pipe()
    monkeypatch.setattr(sys, "stdout", os.fdopen(write, "w"))
    voices = [Voice() for _ in range(ATTEMPTS)]
    for voice in voices:
        emulator = running.get(wire, config)
        factory = wire_factory(wire, config, emulator.endpoints)
        backend = EmulatedWireBackend(
            wire, G1, MonotonicClock(), factory, emulator, control_period_s=PERIOD_S, link_timeout_s=5 * PERIOD_S
        )
        with backend:
            machine, story = _run(backend, actor, voice)
            time.sleep(2 * PERIOD_S)
            at_the_end = set(emulator.control.status()["mode"].values())
        if machine.fault is None:
            break
    os.close(read)
    assert all(voice.close() for voice in voices)
    assert machine.fault is None
    assert story.while_stalled == {"driven"}
    assert at_the_end == {"damped"}
    assert 0.0 <= story.damped_s - story.lost_s - DAMP_AFTER_S < 3 * PERIOD_S + LATE_S + grace_s


def _run(backend: EmulatedWireBackend, actor: Path, voice: Voice) -> tuple[StateMachine, Story]:
    machine = StateMachine(G1, None, [load_run(str(actor), None, G1, SETTINGS.entry)], SETTINGS, PERIOD_S)
    ready(backend)
    for _ in range(round(0.5 / PERIOD_S)):
        backend.write(hold(G1))
        time.sleep(0.02)
    machine.start_tracking()
    person = Person()
    story = Story(backend, machine, voice, person)
    settings = replace(SETTINGS.operator, hold_after_s=DAMP_AFTER_S, lower_after_s=DAMP_AFTER_S)
    presence = Presence([person], lambda: machine.mode, backend.clock, settings, voice.complain)
    observers = Observers([Console(voice, backend, backend.clock, refusals=True)], voice.complain)
    tick = Tick(machine, Guard(G1, SETTINGS, PERIOD_S))
    Loop(backend, backend.clock, tick, plan=story, operators=[presence], observers=[observers]).run()
    return machine, story
