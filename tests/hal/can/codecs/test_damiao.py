"""Damiao frames, worked out by hand from the vendor's layout: p 16 | v 12 | kp 12 | kd 12 | tau 12, big-endian.

DM4310: +-12.5 rad, +-30 rad/s, +-10 Nm, kp 0..500, kd 0..5.
"""

import math
import struct

import pytest

from hal.can.codec import CONTROL_MODE, WATCHDOG_S, CommandKind, MotorCommand, MotorState
from hal.can.codecs import make_codec
from hal.can.frame import Frame
from hal.can.messages import Ack, Feedback, Parameter
from hal.contract.types import DeviceFault

CODEC = make_codec("damiao", 5, "DM4310")
MST_ID = 0x15


def data(text):
    return bytes.fromhex(text)


def answer(text):
    return CODEC.parse(Frame(MST_ID, data(text)))


def test_a_command_by_hand():
    # p 18.75/25*65535 = 49151.25; v 15/60*4095 = 1023.75; kp, kd 0.25*4095 = 1023.75; tau 15/20*4095 = 3071.25
    frames = CODEC.command(MotorCommand(6.25, -15.0, 125.0, 1.25, 5.0))
    assert frames == (Frame(5, data("BF FF 40 04 00 40 0B FF")),)


def test_the_range_ends_by_hand():
    assert CODEC.command(MotorCommand(-12.5, -30.0, 0.0, 5.0, -10.0))[0].data == data("00 00 00 00 00 FF F0 00")
    assert CODEC.command(MotorCommand(12.5, 30.0, 0.0, 0.0, 10.0))[0].data == data("FF FF FF F0 00 00 0F FF")
    assert CODEC.command(MotorCommand(99.0, -99.0, 9999.0, 99.0, 99.0))[0].data == data("FF FF 00 0F FF FF FF FF")


def test_damping_by_hand():
    assert CODEC.damping(2.5) == (Frame(5, data("80 00 80 00 00 80 08 00")),)


def test_switching_frames():
    assert CODEC.enable() == (Frame(5, data("FF FF FF FF FF FF FF FC")),)
    assert CODEC.disable() == (Frame(5, data("FF FF FF FF FF FF FF FD")),)
    assert CODEC.set_zero() == (Frame(5, data("FF FF FF FF FF FF FF FE")),)
    assert CODEC.clear_fault() == (Frame(5, data("FF FF FF FF FF FF FF FB")),)
    assert CODEC.request_state() == (Frame(0x7FF, data("05 00 CC 00 00 00 00 00")),)


def test_the_highest_command_is_not_mistaken_for_a_switch():
    frame = CODEC.command(MotorCommand(12.5, 30.0, 500.0, 5.0, 10.0))[0]
    assert frame.data == data("FF FF FF EF FF FF FF FF")
    assert CODEC.parse_command(frame, MotorCommand()).kind is CommandKind.CONTROL


def test_a_small_kd_does_not_vanish():
    assert CODEC.command(MotorCommand(kp=100.0, kd=1e-6))[0].data[5:7] == data("00 18")


def test_stiffness_without_damping_is_refused():
    with pytest.raises(ValueError, match="kp 10 with kd 0"):
        CODEC.command(MotorCommand(kp=10.0))


def test_a_state_by_hand():
    # D0 = id 5, status 1; p 0xBFFF; v 0x400; tau 0xBFF; 40 and 55 degC
    got = answer("15 BF FF 40 0B FF 28 37")
    assert got.pos_rad == pytest.approx(49151 / 65535 * 25 - 12.5, abs=1e-12)
    assert got.vel_rad_s == pytest.approx(1024 / 4095 * 60 - 30, abs=1e-12)
    assert got.torque_nm == pytest.approx(3071 / 4095 * 20 - 10, abs=1e-12)
    assert (got.motor_id, got.temperature_c, got.faults, got.enabled) == (5, 55.0, (), True)


@pytest.mark.parametrize(
    ("status", "faults", "enabled"),
    [
        (0x0, (), False),
        (0x8, ("over_voltage",), False),
        (0x9, ("under_voltage",), False),
        (0xA, ("over_current",), False),
        (0xB, ("driver_over_temperature",), False),
        (0xC, ("motor_over_temperature",), False),
        (0xD, ("communication_lost",), False),
        (0xE, ("overload",), False),
        (0x5, ("status_5",), False),
    ],
)
def test_the_status_nibble(status, faults, enabled):
    got = CODEC.parse(Frame(MST_ID, bytes([status << 4 | 5]) + data("80 00 80 08 00 19 19")))
    assert (got.faults, got.enabled) == (faults, enabled)


def test_a_write_echo_is_not_a_state_at_minus_12_47_rad():
    assert answer("05 00 55 09 D0 07 00 00") == Ack(5, "write register 9")
    assert answer("05 00 AA 01 00 00 00 00") == Ack(5, "store")
    assert answer("05 00 CC 00 00 00 00 00") is None


def test_a_register_answer_of_another_motor_on_the_same_id_is_dropped():
    assert answer("06 00 33 15 00 00 48 41") is None
    assert answer("06 00 55 09 D0 07 00 00") is None


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x14, data("15 BF FF 40 0B FF 28 37")),
        Frame(MST_ID, data("16 BF FF 40 0B FF 28 37")),
        Frame(MST_ID, data("15 BF FF 40 0B FF 28")),
        Frame(MST_ID, data("15 BF FF 40 0B FF 28 37"), extended=True),
        Frame(MST_ID, b"", remote=True),
    ],
    ids=["other id", "other motor in D0", "7 bytes", "29 bit", "remote"],
)
def test_what_is_not_certainly_its_state_is_dropped(frame):
    assert CODEC.parse(frame) is None


def test_watchdog_by_hand():
    # 0.1 s in steps of 50 us = 2000 = 0x7D0
    assert CODEC.set_watchdog(0.1) == (Frame(0x7FF, data("05 00 55 09 D0 07 00 00")),)
    assert CODEC.read_watchdog() == (Frame(0x7FF, data("05 00 33 09 00 00 00 00")),)
    assert answer("05 00 33 09 D0 07 00 00") == Parameter(5, WATCHDOG_S, 0.1)


def test_ranges_are_read_from_the_motor():
    assert [frame.data for frame in CODEC.read_setup()] == [
        data("05 00 33 0A 00 00 00 00"),
        data("05 00 33 15 00 00 00 00"),
        data("05 00 33 16 00 00 00 00"),
        data("05 00 33 17 00 00 00 00"),
    ]
    said = [answer("05 00 33 0A 01 00 00 00"), answer("05 00 33 15 00 00 48 41")]
    assert said == [Parameter(5, CONTROL_MODE, 1.0), Parameter(5, "pos_range_rad", 12.5)]
    values = {CONTROL_MODE: 1.0, "pos_range_rad": 12.5, "vel_range_rad_s": 15.0, "torque_range_nm": 20.0}
    read = CODEC.with_setup(values)
    # the same -15 rad/s and 5 Nm: now code 0 and 25/40*4095 = 2559.4 = 0x9FF
    assert read.command(MotorCommand(6.25, -15.0, 125.0, 1.25, 5.0))[0].data == data("BF FF 00 04 00 40 09 FF")


@pytest.mark.parametrize(
    ("name", "value"), [(CONTROL_MODE, 2.0), ("vel_range_rad_s", 0.0), ("pos_range_rad", math.nan)]
)
def test_an_unusable_motor_is_refused(name, value):
    good = {CONTROL_MODE: 1.0, "pos_range_rad": 12.5, "vel_range_rad_s": 30.0, "torque_range_nm": 10.0}
    with pytest.raises(DeviceFault, match="damiao motor 5"):
        CODEC.with_setup(good | {name: value})


def test_scan():
    assert CODEC.probe(5, 0) == (Frame(0x7FF, data("05 00 33 07 00 00 00 00")),)
    found = type(CODEC).recognise(Frame(0x15, data("05 00 33 07 15 00 00 00")))
    assert (found.codec, found.motor_id, found.details) == ("damiao", 5, {"host_id": "21"})
    assert type(CODEC).recognise(Frame(0x16, data("05 00 33 07 15 00 00 00"))) is None


def test_the_motor_answers_as_the_host_reads():
    for frame in (*CODEC.read_setup(), *CODEC.read_watchdog()):
        asked = CODEC.parse_command(frame, MotorCommand())
        assert asked.kind is CommandKind.READ
        said = CODEC.parse(CODEC.reply_frames(asked, 2.0)[0])
        assert said == Parameter(5, asked.name, 2.0)
    written = CODEC.parse_command(CODEC.set_watchdog(0.06)[0], MotorCommand())
    assert (written.kind, written.name, written.value) == (CommandKind.WRITE, WATCHDOG_S, 0.06)
    assert CODEC.parse(CODEC.reply_frames(written)[0]) == Ack(5, "write register 9")
    probed = CODEC.parse_command(CODEC.probe(5, 0)[0], MotorCommand())
    assert type(CODEC).recognise(CODEC.reply_frames(probed)[0]).motor_id == 5


def test_a_motor_state_by_hand():
    state = MotorState(6.25, -15.0, 5.0, 55.0, enabled=True)
    assert CODEC.feedback_frames(state) == (Frame(MST_ID, data("15 BF FF 40 0B FF 37 37")),)
    tripped = MotorState(6.25, -15.0, 5.0, 55.0, faults=("communication_lost",))
    assert CODEC.feedback_frames(tripped)[0].data[0] == 0xD5


def test_only_the_low_nibble_of_the_id_is_in_the_state():
    codec = make_codec("damiao", 0x25, "DM4310", host_id=0x100)
    assert isinstance(codec.parse(Frame(0x100, data("15 BF FF 40 0B FF 28 37"))), Feedback)


def test_a_float_register_keeps_its_value():
    asked = CODEC.parse_command(CODEC.read_setup()[1], MotorCommand())
    assert CODEC.reply_frames(asked, 12.5)[0].data[4:] == struct.pack("<f", 12.5)
