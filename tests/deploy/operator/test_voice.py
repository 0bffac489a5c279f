"""A console that is stopped or gone, and what goes on all the same."""

import os
import sys
import threading
import time

from deploy.operator.voice import LINES, Voice
from deploy.record.observers import Observers


def test_lines_in_order_on_both_outputs(capsys):
    voice = Voice()
    for number in range(20):
        (voice.say if number % 2 else voice.complain)(str(number))
    assert voice.close()
    out, error = capsys.readouterr()
    assert out.split() == [str(n) for n in range(1, 20, 2)] and error.split() == [str(n) for n in range(0, 20, 2)]


def test_a_console_that_takes_nothing_holds_nobody_up_and_costs_counted_lines(monkeypatch, capsys):
    read, write = os.pipe()
    stalled = os.fdopen(write, "w")
    monkeypatch.setattr(sys, "stdout", stalled)
    voice = Voice()
    begun_s = time.monotonic()
    for _ in range(LINES + 200):
        voice.say(1000 * "x")
    assert time.monotonic() - begun_s < 1.0
    assert not voice.close() and time.monotonic() - begun_s < 4.0
    reader = threading.Thread(
        target=lambda: [chunk for chunk in iter(lambda: os.read(read, 1 << 16), b"")], daemon=True
    )
    reader.start()
    end_s = time.monotonic() + 5.0
    while "lines lost: the console was too slow" not in (error := capsys.readouterr().err) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert int(error.split()[0]) >= 100
    assert voice.close()


def test_an_output_that_is_gone_is_given_up_and_the_other_one_says_so(monkeypatch, capsys):
    read, write = os.pipe()
    broken = os.fdopen(write, "w")
    os.close(read)
    monkeypatch.setattr(sys, "stdout", broken)
    voice = Voice()
    voice.say("lost")
    voice.say("likewise")
    time.sleep(0.1)
    voice.complain("still here")
    assert voice.close()
    assert capsys.readouterr().err.splitlines() == [
        "standard output is gone ([Errno 32] Broken pipe), going on without it",
        "still here",
    ]
    broken.close()


def test_an_observer_that_raises_is_left_out_and_the_others_go_on():
    seen, said = [], []

    class Breaks:
        def __call__(self, state, result, timer):
            seen.append("breaks")
            raise ZeroDivisionError("bug")

    observers = Observers([Breaks(), lambda *tick: seen.append("sees")], said.append)
    for _ in range(3):
        observers(None, None, None)
    assert seen == ["breaks", "sees", "sees", "sees"]
    assert said == ["Breaks failed, going on without it: ZeroDivisionError: bug"]
