"""moteus frames by hand (subframes of the vendor's register protocol) and against the library's own controller."""

import math
import struct
import sys

import pytest

pytest.importorskip("moteus", reason="the extra moteus is not installed")

from core.errors import InputError
from hal.can.codec import SUPPLY_V, WATCHDOG_S, CommandKind, MotorCommand, MotorState
from hal.can.codecs import make_codec, moteus_registers
from hal.can.frame import Frame
from hal.can.messages import Feedback, Parameter

TURN = 2 * math.pi
OPTIONS = {"kp_nm_per_turn": 100 * TURN, "kd_nm_s_per_turn": 2 * TURN, "torque_nm": 8.0}
CODEC = make_codec("moteus", 1, "r4", **OPTIONS)
QUERY = "11 00 1F 01 11 0A 12 0E"


def data(text):
    return bytes.fromhex(text)


def answer(text, arbitration_id=0x100, extended=False):
    return CODEC.parse(Frame(arbitration_id, data(text), extended=extended, fd=True))


def test_a_command_by_hand():
    # mode 10; six floats from 20h: 0.5 turns, 1 turn/s, 2 Nm, kp 50/100, kd 0.5/2, limit 8 Nm; 27h: 0.1 s
    floats = "00 00 00 3F 00 00 80 3F 00 00 00 40 00 00 00 3F 00 00 80 3E 00 00 00 41"
    expected = data(f"01 00 0A 0C 06 20 {floats} 0D 27 CD CC CC 3D {QUERY} 50 50 50 50")
    frames = CODEC.command(MotorCommand(math.pi, TURN, 50.0, 0.5, 2.0))
    assert frames == (Frame(0x8001, expected, extended=True, fd=True),)


def test_damping_by_hand():
    # mode 12; kd_scale (24h) 0.5/2; watchdog
    expected = data(f"01 00 0C 0D 24 00 00 80 3E 0D 27 CD CC CC 3D {QUERY} 50")
    assert CODEC.damping(0.5) == (Frame(0x8001, expected, extended=True, fd=True),)


def test_the_library_packs_the_same():
    import moteus

    controller = moteus.Controller(id=1, transport=object())
    made = controller.make_position(
        position=0.5,
        velocity=1.0,
        feedforward_torque=2.0,
        kp_scale=0.5,
        kd_scale=0.25,
        maximum_torque=8.0,
        watchdog_timeout=0.1,
    )
    sent = CODEC.command(MotorCommand(math.pi, TURN, 50.0, 0.5, 2.0))[0].data
    assert sent.startswith(made.data)
    assert CODEC.disable()[0].data.startswith(controller.make_stop().data)


def test_limits_of_what_is_sent():
    sent = CODEC.command(MotorCommand(1e9, -1e9, 1e9, 1e9, 1e9))[0].data
    values = struct.unpack("<6f", sent[6:30])
    assert values == (1000.0, -1000.0, 8.0, 1.0, 1.0, 8.0)


def test_damping_beyond_the_stiffness_is_cut_as_the_controller_cuts_it():
    sent = CODEC.command(MotorCommand(1.0, 0.0, 10.0, 2.0, 0.5))[0]
    assert CODEC.parse_command(sent, MotorCommand()).command.kd == pytest.approx(0.2)


def test_a_ramp_of_gains_begins_with_all_of_its_damping():
    """kp 5 of 100, kd 0.2 of 2: the controller would cut the damping to half; as the damping frame it is whole."""
    sent = CODEC.command(MotorCommand(1.0, 0.0, 5.0, 0.2, 0.0))[0]
    assert CODEC.parse_command(sent, MotorCommand()).command.kd == pytest.approx(0.2)
    assert CODEC.parse_command(sent, MotorCommand()).command.kp == 0.0
    sent = CODEC.command(MotorCommand(1.0, 0.0, 25.0, 0.2, 0.0))[0]
    assert CODEC.parse_command(sent, MotorCommand()).command.kp == pytest.approx(25.0)
    assert CODEC.parse_command(sent, MotorCommand()).command.kd == pytest.approx(0.2)


def test_a_state_by_hand():
    # mode 10; 0.5 turns, -2 turns/s, 3 Nm; motor 0 degC (no sensor), board 40 degC, fault 0
    got = answer("21 00 0A 2F 01 00 00 00 3F 00 00 00 C0 00 00 40 40 21 0A 00 22 0E 28 00")
    assert got == Feedback(1, math.pi, -4 * math.pi, 3.0, 40.0, (), True)


def test_the_supply_voltage_by_hand():
    # one float from 0Dh: 24 V is 41C00000h, little-endian; 240 as sixteen bits of 0.1 V
    (asked,) = CODEC.ask_supply()
    assert asked == Frame(0x8001, data("1D 0D"), extended=True, fd=True)
    assert answer("2D 0D 00 00 C0 41") == Parameter(1, SUPPLY_V, 24.0)
    assert answer("25 0D F0 00") == Parameter(1, SUPPLY_V, pytest.approx(24.0))
    heard = CODEC.parse_command(asked, MotorCommand())
    assert (heard.kind, heard.name) == (CommandKind.READ, SUPPLY_V)
    assert CODEC.reply_frames(heard, 24.0) == (Frame(0x100, data("2D 0D 00 00 C0 41"), fd=True),)
    assert not CODEC.is_commanded_by(asked)


def test_the_library_asks_the_same():
    import moteus

    controller = moteus.Controller(id=1, transport=object())
    made = controller.make_custom_query({moteus.Register.VOLTAGE: moteus.F32})
    assert CODEC.ask_supply()[0].data == made.data


def test_sixteen_bit_answers_by_hand():
    # 27 = three int16 from 01: 5000 * 1e-4 turns, -4000 * 0.00025 turns/s, 150 * 0.01 Nm
    got = answer("21 00 0A 27 01 88 13 60 F0 96 00")
    assert (got.pos_rad, got.vel_rad_s, got.torque_nm) == pytest.approx((math.pi, -TURN, 1.5))
    assert math.isnan(answer("21 00 0A 27 01 00 80 60 F0 96 00").pos_rad)


def test_modes_and_faults():
    assert answer("21 00 01 21 0F 22").faults == ("over_voltage",)
    assert answer("21 00 01 21 0F 2A").faults == ("error_42",)
    timed_out = answer("21 00 0B 21 0F 00")
    assert (timed_out.faults, timed_out.enabled) == (("communication_lost",), False)
    # 96: which limit is active, no fault
    limited = answer("21 00 0A 21 0F 60")
    assert (limited.faults, limited.enabled) == ((), True)
    assert answer("21 00 63") is None


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x200, data("21 00 0A"), fd=True),
        Frame(0x100, data("21 00 0A")),
        Frame(0x100, data("21 00 0A"), extended=True, fd=True),
        Frame(0x100, data("01 00 0A"), fd=True),
        Frame(0x100, data("31 01 02"), fd=True),
        Frame(0x100, data("2F 01 00 00"), fd=True),
        Frame(0x100, b"", fd=True),
        Frame(0x8001, data(QUERY), extended=True, fd=True),
    ],
    ids=["other motor", "classic", "29 bit", "a write", "an error", "cut", "empty", "own query"],
)
def test_what_is_not_certainly_its_state_is_dropped(frame):
    assert CODEC.parse(frame) is None


def test_a_frame_that_asks_for_billions_of_registers_is_dropped_at_once():
    frame = Frame(0x8001, data("10 FF FF FF FF 0F 00"), extended=True, fd=True)
    assert CODEC.parse_command(frame, MotorCommand()) is None


def test_ids_above_seven_answer_in_extended_frames():
    codec = make_codec("moteus", 8, "r4", **OPTIONS)
    sent = codec.feedback_frames(MotorState(0.0, 0.0, 0.0))[0]
    assert (sent.arbitration_id, sent.extended) == (0x800, True)
    assert codec.parse(sent).motor_id == 8


def test_watchdog_by_hand():
    # a stop that carries 27h; read back with a float question
    assert CODEC.set_watchdog(0.5)[0].data == data(f"01 00 00 0D 27 00 00 00 3F {QUERY} 50 50 50")
    assert CODEC.read_watchdog() == (Frame(0x8001, data("1D 27"), extended=True, fd=True),)
    assert answer("2D 27 00 00 00 3F") == Parameter(1, WATCHDOG_S, 0.5)
    longer = CODEC.with_setup({WATCHDOG_S: 0.5})
    assert longer.damping(0.5)[0].data[9:15] == data("0D 27 00 00 00 3F")


def test_the_motor_answers_as_the_host_reads():
    asked = CODEC.parse_command(CODEC.read_setup()[0], MotorCommand())
    assert CODEC.parse(CODEC.reply_frames(asked, 0.5)[0]) == Parameter(1, WATCHDOG_S, 0.5)
    written = CODEC.parse_command(CODEC.set_watchdog(0.5)[0], MotorCommand())
    assert (written.kind, written.name, written.value) == (CommandKind.WRITE, WATCHDOG_S, 0.5)
    frames = (*CODEC.enable(), *CODEC.disable(), *CODEC.set_zero(), *CODEC.request_state(), *CODEC.probe(1, 0))
    kinds = [CODEC.parse_command(frame, MotorCommand()).kind for frame in frames]
    assert kinds == [
        CommandKind.CONTROL,
        CommandKind.DISABLE,
        CommandKind.SET_ZERO,
        CommandKind.REQUEST_STATE,
        CommandKind.REQUEST_STATE,
    ]
    assert CODEC.parse_command(CODEC.enable()[0], MotorCommand()).command == MotorCommand()


def test_a_fault_and_the_time_out_as_the_motor_sends_them():
    tripped = CODEC.parse(CODEC.feedback_frames(MotorState(0.0, 0.0, 0.0, faults=("under_voltage",)))[0])
    assert (tripped.faults, tripped.enabled) == (("under_voltage",), False)
    late = CODEC.parse(CODEC.feedback_frames(MotorState(0.0, 0.0, 0.0, faults=("communication_lost",)))[0])
    assert late.faults == ("communication_lost",)


def test_scan():
    found = type(CODEC).recognise(Frame(0x500, data("21 00 00"), fd=True))
    assert (found.codec, found.motor_id) == ("moteus", 5)


def test_without_the_library_the_message_says_what_to_install(monkeypatch):
    moteus_registers.library.cache_clear()
    monkeypatch.setitem(sys.modules, "moteus", None)
    try:
        with pytest.raises(InputError, match=r"pip install -e '\.\[moteus\]'"):
            make_codec("moteus", 1, "r4", **OPTIONS)
    finally:
        moteus_registers.library.cache_clear()


def test_the_configured_gains_must_be_given():
    with pytest.raises(InputError, match="kp_nm_per_turn"):
        make_codec("moteus", 1, "r4", kd_nm_s_per_turn=1.0, torque_nm=1.0)
