"""CubeMars AK frames by hand. AK80-9: +-12.5 rad, +-50 rad/s, +-18 Nm, kp 0..500, kd 0..5."""

import pytest

from hal.can.codec import CommandKind, MotorCommand, MotorState
from hal.can.codecs import make_codec
from hal.can.frame import Frame
from hal.can.messages import Feedback

CODEC = make_codec("cubemars", 3, "AK80-9")


def data(text):
    return bytes.fromhex(text)


def test_a_command_by_hand():
    frames = CODEC.command(MotorCommand(6.25, -25.0, 125.0, 1.25, 9.0))
    assert frames == (Frame(3, data("BF FF 40 04 00 40 0B FF")),)


@pytest.mark.parametrize("field", ["q_rad", "dq_rad_s", "kp", "kd", "tau_nm"])
def test_the_upper_end_is_not_the_lower_one(field):
    """The vendor's own encoder divides by 2^n: +12.5 rad becomes -12.5 rad."""
    top = {"q_rad": 12.5, "dq_rad_s": 50.0, "kp": 500.0, "kd": 5.0, "tau_nm": 18.0}[field]
    sent = CODEC.command(MotorCommand(**({"kd": 1.0} | {field: top})))[0]
    got = CODEC.parse_command(sent, MotorCommand()).command
    assert getattr(got, field) == top


def test_damping_by_hand():
    assert CODEC.damping(2.5) == (Frame(3, data("80 00 80 00 00 80 08 00")),)


def test_switching_frames():
    assert CODEC.enable() == (Frame(3, data("FF FF FF FF FF FF FF FC")),)
    assert CODEC.disable() == (Frame(3, data("FF FF FF FF FF FF FF FD")),)
    assert CODEC.set_zero() == (Frame(3, data("FF FF FF FF FF FF FF FE")),)
    assert CODEC.request_state() == CODEC.clear_fault() == CODEC.probe(3, 0) == CODEC.disable()


def test_a_state_by_hand():
    # temperature 75 - 40 = 35 degC, error 2
    got = CODEC.parse(Frame(3, data("03 BF FF 40 0B FF 4B 02")))
    assert got.pos_rad == pytest.approx(49151 / 65535 * 25 - 12.5, abs=1e-12)
    assert got.vel_rad_s == pytest.approx(1024 / 4095 * 100 - 50, abs=1e-12)
    assert got.torque_nm == pytest.approx(3071 / 4095 * 36 - 18, abs=1e-12)
    assert (got.temperature_c, got.faults, got.enabled) == (35.0, ("over_current",), None)


def test_six_bytes_carry_neither_temperature_nor_fault():
    got = CODEC.parse(Frame(3, data("03 FF FF FF F0 00")))
    assert got == Feedback(3, 12.5, 50.0, -18.0, temperature_c=None, faults=None, enabled=None)


@pytest.mark.parametrize(
    ("code", "name"),
    [
        (1, "motor_over_temperature"),
        (2, "over_current"),
        (3, "over_voltage"),
        (4, "under_voltage"),
        (5, "encoder"),
        (6, "driver_over_temperature"),
        (7, "overload"),
        (9, "error_9"),
    ],
)
def test_error_codes(code, name):
    assert CODEC.parse(Frame(3, data("03 80 00 80 08 00 4B") + bytes([code]))).faults == (name,)


@pytest.mark.parametrize(
    "frame",
    [
        Frame(4, data("03 BF FF 40 0B FF 4B 00")),
        Frame(3, data("04 BF FF 40 0B FF 4B 00")),
        Frame(3, data("03 BF FF 40 0B FF 4B")),
        Frame(3, data("03 BF FF 40 0B FF 4B 00"), extended=True),
        Frame(3, data("FF FF FF FF FF FF FF FC")),
    ],
    ids=["other id", "other motor", "7 bytes", "29 bit", "own switch, looped back"],
)
def test_what_is_not_certainly_its_state_is_dropped(frame):
    assert CODEC.parse(frame) is None


def test_answers_on_a_master_id():
    codec = make_codec("cubemars", 3, "AK80-9", host_id=0x43)
    assert codec.parse(Frame(3, data("03 BF FF 40 0B FF 4B 00"))) is None
    assert codec.parse(Frame(0x43, data("03 BF FF 40 0B FF 4B 00"))).motor_id == 3


def test_the_host_knows_of_no_watchdog():
    assert not CODEC.has_watchdog
    assert CODEC.set_watchdog(0.1) == CODEC.read_watchdog() == CODEC.read_setup() == ()


def test_a_motor_state_by_hand():
    state = MotorState(6.25, -25.0, 9.0, 35.0, enabled=True, faults=("encoder",))
    assert CODEC.feedback_frames(state) == (Frame(3, data("03 BF FF 40 0B FF 4B 05")),)


def test_scan_and_switches_as_the_motor_reads_them():
    found = type(CODEC).recognise(CODEC.feedback_frames(MotorState(0.0, 0.0, 0.0))[0])
    assert (found.codec, found.motor_id) == ("cubemars", 3)
    kinds = [
        CODEC.parse_command(f, MotorCommand()).kind for f in (*CODEC.enable(), *CODEC.disable(), *CODEC.set_zero())
    ]
    assert kinds == [CommandKind.ENABLE, CommandKind.DISABLE, CommandKind.SET_ZERO]
