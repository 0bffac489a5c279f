"""Exchanges on a pseudo-terminal with a servo side that says exactly what a test wants."""

import os
import threading
import time
import tty
from collections.abc import Callable

import pytest

from hal.contract.types import DeviceError
from hal.dynamixel import protocol2 as p2
from hal.dynamixel.port import ServoPort, Silent, latency_timer_ms
from hal.dynamixel.protocol2 import Answer, Packet
from hal.dynamixel.questions import Heard, StateQuestions

pytestmark = pytest.mark.real_time

LONG_S = 5.0
SHORT_S = 0.2


class Line:
    """A port and, at its other end, a thread that answers each packet with what `script` gives for it."""

    def __init__(self, script: Callable[[Packet], bytes]) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._script = script
        self.port = ServoPort(os.ttyname(self._slave), 1_000_000)
        self.port.open()
        self.heard: list[Packet] = []
        self._thread = threading.Thread(target=self._answer, daemon=True)
        self._thread.start()

    def _answer(self) -> None:
        parser = p2.PacketParser()
        while True:
            try:
                data = os.read(self.master, 4096)
            except OSError:
                return
            for packet in parser.feed(data):
                self.heard.append(packet)
                if reply := self._script(packet):
                    os.write(self.master, reply)

    def close(self) -> None:
        self.port.close()
        os.close(self._slave)
        os.close(self.master)


@pytest.fixture
def line():
    made: list[Line] = []

    def make(script: Callable[[Packet], bytes]) -> Line:
        made.append(Line(script))
        return made[-1]

    yield make
    for one in made:
        one.close()


def status(servo_id: int, error: int = 0, size: int = 21) -> bytes:
    return p2.status(servo_id, error, bytes([servo_id] * size))


def size_of(packet: Packet) -> int:
    return p2.sync_read_of(packet.params)[1]


def ask(line: Line, ids: tuple[int, ...], limit_s: float, *, fast: bool = False) -> dict[int, Heard]:
    """The first question of a port: 21 bytes."""
    return again(StateQuestions(line.port, fast=fast), ids, limit_s)


def again(questions: StateQuestions, ids: tuple[int, ...], limit_s: float) -> dict[int, Heard]:
    return {one.id: one for one in questions.ask(ids, time.monotonic() + limit_s)[1]}


def test_all_that_answer_are_heard_with_their_errors(line) -> None:
    bus = line(lambda _: status(1) + status(2, p2.ALERT) + status(3))
    start_s = time.monotonic()
    heard = ask(bus, (1, 2, 3), LONG_S)
    assert time.monotonic() - start_s < LONG_S  # as soon as all are there
    assert sorted(heard) == [1, 2, 3]
    assert (heard[2].error, heard[2].state) == (p2.ALERT, b"\2" * 21)
    assert heard[1].asked_s >= start_s
    assert bus.heard[0] == Packet(p2.BROADCAST, p2.SYNC_READ, bytes.fromhex("7e00 1500 010203"))


def test_a_silent_servo_costs_only_itself(line) -> None:
    assert sorted(ask(line(lambda _: status(1) + status(3)), (1, 2, 3), SHORT_S)) == [1, 3]


def test_an_altered_answer_costs_only_itself(line) -> None:
    spoilt = bytearray(status(2))
    spoilt[10] ^= 4
    assert sorted(ask(line(lambda _: status(1) + bytes(spoilt) + status(3)), (1, 2, 3), SHORT_S)) == [1, 3]


def test_an_id_that_answers_twice_is_believed_neither_time(line) -> None:
    assert sorted(ask(line(lambda _: status(1) + status(3) + status(3)), (1, 2, 3), SHORT_S)) == [1]


def test_other_ids_and_sizes_are_not_taken_for_answers(line) -> None:
    bus = line(lambda _: status(9) + p2.status(2, 0, b"\0") + status(1) + p2.packet(2, p2.PING))
    assert sorted(ask(bus, (1, 2), SHORT_S)) == [1]


def test_a_fast_answer_that_breaks_off_keeps_its_beginning(line) -> None:
    whole = [Answer(i, 0, bytes([i] * 21)) for i in (1, 2, 3)]
    bus = line(lambda _: p2.fast_status(whole, 21, 3))
    assert sorted(ask(bus, (1, 2, 3), LONG_S, fast=True)) == [1, 2, 3]
    assert bus.heard[0].instruction == p2.FAST_SYNC_READ
    assert sorted(ask(line(lambda _: p2.fast_status(whole[:2], 21, 3)), (1, 2, 3), SHORT_S, fast=True)) == [1, 2]


def test_a_part_of_a_fast_answer_under_another_id_is_not_believed(line) -> None:
    parts = [Answer(shown, 0, bytes(21)) for shown in (1, 103, 3)]
    assert sorted(ask(line(lambda _: p2.fast_status(parts, 21, 3)), (1, 2, 3), SHORT_S, fast=True)) == [1, 3]


def test_successive_questions_differ_and_give_the_same_registers(line) -> None:
    bus = line(lambda packet: p2.status(1, 0, bytes(range(100, 125))[-size_of(packet) :]))
    questions = StateQuestions(bus.port, fast=False)
    assert {again(questions, (1,), LONG_S)[1].state for _ in range(5)} == {bytes(range(104, 125))}
    assert [p2.sync_read_of(packet.params)[:2] for packet in bus.heard] == [
        (126, 21), (124, 23), (123, 24), (122, 25), (126, 21),
    ]  # fmt: skip


@pytest.mark.parametrize("fast", [False, True])
def test_a_late_answer_is_known_by_its_length_and_keeps_its_age(line, fast: bool) -> None:
    """Every answer comes one question too late, as through an adapter that holds bytes back."""
    held: list[bytes] = [b""]

    def late(packet: Packet) -> bytes:
        size = size_of(packet)
        answer = p2.fast_status([Answer(1, 0, bytes(size))], size, 1) if fast else p2.status(1, 0, bytes(size))
        held.append(answer)
        return held[-2]

    questions = StateQuestions(line(late).port, fast=fast)
    asked_s = []
    for i in range(6):
        at_s, heard = questions.ask((1,), time.monotonic() + SHORT_S)
        asked_s.append(at_s)
        assert [one.asked_s for one in heard] == ([asked_s[i - 1]] if i else [])


def test_what_arrives_between_two_questions_is_heard_with_its_own_age(line) -> None:
    bus = line(lambda packet: status(2, size=size_of(packet)))
    questions = StateQuestions(bus.port, fast=False)
    first_s, heard = questions.ask((1, 2), time.monotonic() + SHORT_S)
    assert [one.id for one in heard] == [2]
    os.write(bus.master, status(1))
    deadline_s = time.monotonic() + LONG_S
    while not bus.port._port.in_waiting and time.monotonic() < deadline_s:
        time.sleep(0.001)
    second_s, heard = questions.ask((1, 2), time.monotonic() + SHORT_S)
    assert {one.id: one.asked_s for one in heard} == {1: first_s, 2: second_s}


def test_one_servo_is_asked_and_its_silence_said(line) -> None:
    bus = line(lambda packet: status(packet.id, size=4) if packet.id == 1 else b"")
    assert bus.port.ask(1, p2.read(1, 132, 4), 4, LONG_S).params == b"\1\1\1\1"
    with pytest.raises(Silent, match="id 2"):
        bus.port.ask(2, p2.read(2, 132, 4), 4, SHORT_S)


def test_a_port_that_goes_away_is_a_device_error_and_closed(line) -> None:
    bus = line(lambda _: b"")
    os.close(bus.master)
    with pytest.raises(DeviceError, match="gone"):
        for _ in range(100):
            ask(bus, (1,), SHORT_S)
    assert not bus.port.is_open
    bus.master, _ = os.openpty()


def test_a_port_that_does_not_exist_is_named() -> None:
    with pytest.raises(DeviceError, match="no/such/port"):
        ServoPort("no/such/port", 1_000_000).open()


@pytest.mark.parametrize("baud", [57_600, 1_000_000, 3_000_000, 4_000_000, 4_500_000])
def test_every_baud_rate_can_be_set(baud: int) -> None:
    master, slave = os.openpty()
    port = ServoPort(os.ttyname(slave), baud)
    port.open()
    assert port.is_open
    port.close()
    os.close(master)
    os.close(slave)


def test_the_latency_timer_of_an_adapter_is_read(tmp_path, monkeypatch) -> None:
    (tmp_path / "ttyUSB7").mkdir()
    (tmp_path / "ttyUSB7" / "latency_timer").write_text("16\n")
    monkeypatch.setattr("hal.dynamixel.port.SYSFS", tmp_path)
    link = tmp_path / "left_leg"
    link.symlink_to("/dev/ttyUSB7")
    assert latency_timer_ms(str(link)) == 16
    assert latency_timer_ms("/dev/pts/0") is None
