"""ODrive CANSimple frames by hand: id = node << 5 | command, little-endian."""

import math
import struct

import numpy as np
import pytest

from core.errors import InputError
from hal.can.codec import WATCHDOG_S, CommandKind, MotorCommand, MotorState
from hal.can.codecs import make_codec
from hal.can.frame import Frame
from hal.can.messages import Feedback, Parameter
from hal.contract.types import DeviceFault

CODEC = make_codec("odrive", 3, "S1")
WATCHED = make_codec("odrive", 3, "S1", enable_watchdog_endpoint=0x0123, watchdog_timeout_endpoint=0x0456)
TURN = 2 * math.pi


def data(text):
    return bytes.fromhex(text)


def test_a_command_by_hand():
    # kd 0.5: vel_gain pi; kp 10: pos_gain 20; half a turn; 1.5 turns/s = 1500; -2.5 Nm = -2500 = F63Ch
    frames = CODEC.command(MotorCommand(math.pi, 1.5 * TURN, 10.0, 0.5, -2.5))
    assert frames == (
        Frame(0x7B, data("DB 0F 49 40 00 00 00 00")),
        Frame(0x7A, data("00 00 A0 41")),
        Frame(0x6C, data("00 00 00 3F DC 05 3C F6")),
    )


def test_gains_that_the_drive_holds_are_not_sent_again():
    held = MotorCommand(0.0, 0.0, 10.0, 0.5, 0.0)
    assert CODEC.command(MotorCommand(math.pi, 0.0, 10.0, 0.5, 0.0), held) == (
        Frame(0x6C, data("00 00 00 3F 00 00 00 00")),
    )


def test_damping_by_hand():
    assert CODEC.damping(0.5) == (
        Frame(0x7A, bytes(4)),
        Frame(0x7B, data("DB 0F 49 40 00 00 00 00")),
        Frame(0x6C, bytes(8)),
    )


def test_no_frame_of_a_change_is_stiffer_than_both_ends():
    rng = np.random.default_rng(7)
    for _ in range(200):
        first, second = (
            MotorCommand(kp=float(kp), kd=float(kd)) for kp, kd in zip(rng.uniform(0, 50, 2), rng.uniform(0.1, 5, 2))
        )
        held, stiffness = first, []
        for frame in CODEC.command(second, first):
            held = CODEC.parse_command(frame, held).command
            stiffness.append(held.kp)
        assert max(stiffness) <= max(first.kp, second.kp) * (1 + 1e-6)
        assert (held.kp, held.kd) == pytest.approx((second.kp, second.kd), rel=1e-6)


def test_feed_forward_saturates_and_the_position_is_bounded():
    frame = CODEC.command(MotorCommand(1e30, 1e4, 0.0, 0.5, -1e4))[-1]
    assert frame.data == struct.pack("<f", 1000.0) + data("FF 7F 01 80")


def test_stiffness_without_damping_is_refused():
    with pytest.raises(ValueError, match="multiple of its damping"):
        CODEC.command(MotorCommand(kp=10.0))


def test_switching_frames():
    assert CODEC.enable() == (
        Frame(0x7A, bytes(4)),
        Frame(0x7B, bytes(8)),
        Frame(0x6B, data("03 00 00 00 01 00 00 00")),
        Frame(0x67, data("08 00 00 00")),
    )
    assert CODEC.disable() == (Frame(0x67, data("01 00 00 00")),)
    assert CODEC.clear_fault() == (Frame(0x78, b"\0"),)
    assert CODEC.set_zero() == (Frame(0x79, bytes(4)),)
    assert CODEC.request_state()[0] == Frame(0x69, remote=True)


def test_estimates_by_hand():
    # 0.5 turns and -2 turns/s
    got = CODEC.parse(Frame(0x69, data("00 00 00 3F 00 00 00 C0")))
    assert got == Feedback(3, pos_rad=math.pi, vel_rad_s=-4 * math.pi)


def test_torque_is_the_estimate_not_the_target():
    assert CODEC.parse(Frame(0x7C, data("00 00 80 3F 00 00 00 40"))) == Feedback(3, torque_nm=2.0)


def test_the_supply_is_the_first_of_voltage_and_current():
    """24.5 V and -1 A."""
    assert CODEC.parse(Frame(0x77, data("00 00 C4 41 00 00 80 BF"))) == Feedback(3, supply_v=24.5)


def test_temperature_is_the_higher_of_those_there_are():
    assert CODEC.parse(Frame(0x75, data("00 00 20 42 00 00 C0 7F"))) == Feedback(3, temperature_c=40.0)
    assert CODEC.parse(Frame(0x75, data("00 00 20 42 00 00 48 42"))) == Feedback(3, temperature_c=50.0)
    assert CODEC.parse(Frame(0x75, data("00 00 C0 7F 00 00 C0 7F"))) is None


def test_heartbeat_by_hand():
    # bits 3 and 24, axis state 1
    got = CODEC.parse(Frame(0x61, data("08 00 00 01 01 00 00 00")))
    assert got == Feedback(3, faults=("encoder", "communication_lost"), enabled=False)
    assert CODEC.parse(Frame(0x61, data("00 00 00 00 08 00 00 00"))) == Feedback(3, faults=(), enabled=True)


def test_an_error_and_its_reason():
    got = CODEC.parse(Frame(0x63, data("00 01 00 00 00 00 00 04")))
    assert got.faults == ("over_voltage", "spinout")
    assert CODEC.parse(Frame(0x63, data("00 00 00 80 00 00 00 00"))).faults == ("error_bit_31",)


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x49, data("00 00 00 3F 00 00 00 C0")),
        Frame(0x69, data("00 00 00 3F 00 00 00")),
        Frame(0x69, b"", remote=True),
        Frame(0x69, data("00 00 00 3F 00 00 00 C0"), extended=True),
        Frame(0x6C, bytes(8)),
    ],
    ids=["other node", "7 bytes", "a request", "29 bit", "own command"],
)
def test_what_is_not_certainly_its_state_is_dropped(frame):
    assert CODEC.parse(frame) is None


def test_what_the_device_says_is_passed_on_even_when_it_is_no_number():
    got = CODEC.parse(Frame(0x69, data("00 00 C0 7F 00 00 80 7F")))
    assert math.isnan(got.pos_rad)
    assert got.vel_rad_s == math.inf


def test_watchdog_by_hand():
    assert WATCHED.set_watchdog(0.1) == (
        Frame(0x64, data("01 56 04 00 CD CC CC 3D")),
        Frame(0x64, data("01 23 01 00 01 00 00 00")),
    )
    assert WATCHED.read_watchdog() == (Frame(0x64, data("00 56 04 00 00 00 00 00")),)
    said = WATCHED.parse(Frame(0x65, data("00 56 04 00 CD CC CC 3D")))
    assert said == Parameter(3, WATCHDOG_S, pytest.approx(0.1, rel=1e-6))
    assert WATCHED.parse(Frame(0x65, data("00 23 01 00 01 00 00 00"))) == Parameter(3, "watchdog_enabled", 1.0)
    assert WATCHED.with_setup({"watchdog_enabled": 1.0}) is WATCHED
    with pytest.raises(DeviceFault, match="watchdog is off"):
        WATCHED.with_setup({"watchdog_enabled": 0.0})


def test_without_endpoints_the_host_knows_of_no_watchdog():
    assert not CODEC.has_watchdog
    assert CODEC.set_watchdog(0.1) == CODEC.read_watchdog() == CODEC.read_setup() == CODEC.setup_names == ()
    with pytest.raises(InputError, match="watchdog_timeout_endpoint"):
        make_codec("odrive", 3, "S1", enable_watchdog_endpoint=5)


def test_scan():
    assert CODEC.probe(3, 0) == (Frame(0x66, remote=True),)
    found = type(CODEC).recognise(Frame(0x66, data("03 01 02 03 04 05 06 00")))
    assert (found.motor_id, found.details) == (3, {"serial": "060504030201"})
    assert type(CODEC).recognise(Frame(0x61, data("00 00 00 00 01 00 00 00"))).motor_id == 3
    assert type(CODEC).recognise(Frame(0x66, data("04 01 02 03 04 05 06 00"))) is None


def test_the_motor_answers_as_the_host_reads():
    asked = WATCHED.parse_command(WATCHED.read_watchdog()[0], MotorCommand())
    assert WATCHED.parse(WATCHED.reply_frames(asked, 0.5)[0]) == Parameter(3, WATCHDOG_S, 0.5)
    written = WATCHED.parse_command(WATCHED.set_watchdog(0.5)[0], MotorCommand())
    assert (written.kind, written.value) == (CommandKind.WRITE, 0.5)
    kinds = [CODEC.parse_command(f, MotorCommand()) for f in (*CODEC.enable(), *CODEC.disable(), *CODEC.clear_fault())]
    assert [asked and asked.kind for asked in kinds] == [
        CommandKind.GAINS,
        CommandKind.GAINS,
        None,
        CommandKind.ENABLE,
        CommandKind.DISABLE,
        CommandKind.CLEAR_FAULT,
    ]
    assert not kinds[0].feeds_watchdog


def test_a_motor_state_by_hand():
    frames = CODEC.feedback_frames(MotorState(math.pi, TURN, 2.0, 40.0, enabled=True, faults=("over_voltage",)))
    assert frames[0] == Frame(0x69, data("00 00 00 3F 00 00 80 3F"))
    assert frames[1].arbitration_id == 0x7C
    assert frames[3] == Frame(0x61, data("00 01 00 00 08 00 00 00"))


def test_a_gain_that_is_no_number_changes_nothing():
    assert CODEC.parse_command(Frame(0x7A, data("00 00 C0 7F")), MotorCommand(kd=1.0)) is None
    assert CODEC.parse_command(Frame(0x7A, data("00 00 80 BF")), MotorCommand(kd=1.0)) is None
