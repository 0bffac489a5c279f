"""RobStride frames by hand: id = type<<24 | data2<<8 | destination. RS03: 12.57 rad, 20 rad/s, 60 Nm, 5000, 100."""

import struct

import pytest

from hal.can.codec import SUPPLY_V, WATCHDOG_S, CommandKind, MotorCommand, MotorState
from hal.can.codecs import make_codec
from hal.can.frame import Frame
from hal.can.messages import Ack, Feedback, Identity, Parameter
from hal.contract.types import DeviceFault

CODEC = make_codec("robstride", 5, "RS03")


def frame(arbitration_id, text):
    return Frame(arbitration_id, bytes.fromhex(text), extended=True)


def test_a_command_by_hand():
    # quarters of 65535: 16383.75 -> 4000h, three quarters 49151.25 -> BFFFh; the torque rides in the identifier
    frames = CODEC.command(MotorCommand(6.285, -10.0, 1250.0, 25.0, 30.0))
    assert frames == (frame(0x01BFFF05, "BF FF 40 00 40 00 40 00"),)


def test_the_range_ends_by_hand():
    assert CODEC.command(MotorCommand(-99.0, -99.0, 0.0, 0.0, -99.0)) == (frame(0x01000005, "00 00 00 00 00 00 00 00"),)
    assert CODEC.command(MotorCommand(12.57, 20.0, 5000.0, 100.0, 60.0)) == (
        frame(0x01FFFF05, "FF FF FF FF FF FF FF FF"),
    )


def test_damping_by_hand():
    assert CODEC.damping(50.0) == (frame(0x01800005, "80 00 80 00 00 00 80 00"),)


def test_switching_frames():
    assert CODEC.enable() == (frame(0x1200FD05, "05 70 00 00 00 00 00 00"), frame(0x0300FD05, "00" * 8))
    assert CODEC.disable() == (frame(0x0400FD05, "00" * 8),)
    assert CODEC.clear_fault() == (frame(0x0400FD05, "01" + "00" * 7),)
    assert CODEC.set_zero() == (frame(0x0600FD05, "01" + "00" * 7),)


def test_a_state_by_hand():
    # mode 2 = 0x800000, motor 5, host FD; 41.5 degC = 415 = 019Fh
    got = CODEC.parse(frame(0x028005FD, "BF FF 40 00 BF FF 01 9F"))
    assert got.pos_rad == pytest.approx(49151 / 65535 * 25.14 - 12.57, abs=1e-12)
    assert got.vel_rad_s == pytest.approx(16384 / 65535 * 40 - 20, abs=1e-12)
    assert got.torque_nm == pytest.approx(49151 / 65535 * 120 - 60, abs=1e-12)
    assert (got.temperature_c, got.faults, got.enabled) == (41.5, (), True)


@pytest.mark.parametrize(
    ("bits", "faults"),
    [
        (0x010000, ("under_voltage",)),
        (0x020000, ("over_current",)),
        (0x040000, ("motor_over_temperature",)),
        (0x080000, ("encoder",)),
        (0x100000, ("overload",)),
        (0x200000, ("uncalibrated",)),
        (0x210000, ("under_voltage", "uncalibrated")),
    ],
)
def test_fault_bits_of_a_state_also_two_at_once(bits, faults):
    got = CODEC.parse(frame(0x020005FD | bits, "80 00 80 00 80 00 01 2C"))
    assert (got.faults, got.enabled) == (faults, False)


def test_a_fault_report():
    got = CODEC.parse(frame(0x150005FD, "0C 00 01 00 01 00 00 00"))
    assert got == Feedback(5, faults=("under_voltage", "over_voltage", "over_current"))
    assert CODEC.parse(frame(0x150005FD, "00 00 00 80 00 00 00 00")).faults == ("error_bit_31",)


@pytest.mark.parametrize(
    "wrong",
    [
        frame(0x028006FD, "BF FF 40 00 BF FF 01 9F"),
        frame(0x028005FC, "BF FF 40 00 BF FF 01 9F"),
        frame(0x028005FD, "BF FF 40 00 BF FF 01"),
        frame(0x02C005FD, "BF FF 40 00 BF FF 01 9F"),
        Frame(0x5FD, bytes(8)),
        frame(0x018005FD, "80 00 80 00 00 00 80 00"),
        frame(0x0400FD05, "00" * 8),
    ],
    ids=["other motor", "other host", "7 bytes", "no such mode", "11 bit", "a command", "own stop"],
)
def test_what_is_not_certainly_its_state_is_dropped(wrong):
    assert CODEC.parse(wrong) is None


def test_watchdog_by_hand():
    # 20000 per second: 0.1 s = 2000 = 07D0h, little-endian
    assert CODEC.set_watchdog(0.1) == (frame(0x1200FD05, "28 70 00 00 D0 07 00 00"),)
    assert CODEC.read_watchdog() == (frame(0x1100FD05, "28 70 00 00 00 00 00 00"),)
    assert CODEC.parse(frame(0x110005FD, "28 70 00 00 D0 07 00 00")) == Parameter(5, WATCHDOG_S, 0.1)
    assert CODEC.parse(frame(0x110105FD, "28 70 00 00 00 00 00 00")) == Ack(5, f"read {WATCHDOG_S}", ok=False)


def test_the_supply_voltage_by_hand():
    # 48 V is the float 42400000h, little-endian
    assert CODEC.ask_supply() == (frame(0x1100FD05, "1C 70 00 00 00 00 00 00"),)
    said = frame(0x110005FD, "1C 70 00 00 00 00 40 42")
    assert CODEC.parse(said) == Parameter(5, SUPPLY_V, 48.0)
    assert CODEC.parse(frame(0x110105FD, "1C 70 00 00 00 00 00 00")) == Ack(5, f"read {SUPPLY_V}", ok=False)
    asked = CODEC.parse_command(frame(0x1100FD05, "1C 70 00 00 00 00 00 00"), MotorCommand())
    assert (asked.kind, asked.name) == (CommandKind.READ, SUPPLY_V)
    assert CODEC.reply_frames(asked, 48.0) == (said,)
    assert not CODEC.is_commanded_by(CODEC.ask_supply()[0])


def test_the_scaling_is_checked_against_the_float():
    assert CODEC.setup_names[0] == "mechanical_pos_rad"
    assert CODEC.read_setup()[0] == frame(0x1100FD05, "19 70 00 00 00 00 00 00")
    state = CODEC.parse(frame(0x020005FD, "BF FF 80 00 80 00 01 2C"))
    CODEC.check_feedback({"mechanical_pos_rad": 6.29}, state)
    CODEC.check_feedback({"mechanical_pos_rad": 6.29 - 2 * 3.14159265}, state)
    for said in (3.0, float("nan")):
        with pytest.raises(DeviceFault, match="0x7019"):
            CODEC.check_feedback({"mechanical_pos_rad": said}, state)


def test_an_angle_beyond_the_range_wraps():
    got = CODEC.parse(CODEC.feedback_frames(MotorState(12.57 + 1.0, 0.0, 0.0))[0])
    assert got.pos_rad == pytest.approx(-11.57, abs=4e-4)


def test_scan():
    assert CODEC.probe(5, 0xFD) == (frame(0x0000FD05, "00" * 8),)
    found = type(CODEC).recognise(frame(0x000005FE, "01 02 03 04 05 06 07 08"))
    assert (found.motor_id, found.details) == (5, {"serial": "0102030405060708"})
    assert CODEC.parse(frame(0x000005FE, "01 02 03 04 05 06 07 08")) == Identity(5, "0102030405060708")


def test_the_motor_answers_as_the_host_reads():
    asked = CODEC.parse_command(CODEC.read_setup()[0], MotorCommand())
    assert CODEC.parse(CODEC.reply_frames(asked, 1.5)[0]) == Parameter(5, "mechanical_pos_rad", 1.5)
    written = CODEC.parse_command(CODEC.set_watchdog(0.06)[0], MotorCommand())
    assert (written.kind, written.name, written.value) == (CommandKind.WRITE, WATCHDOG_S, 0.06)
    asked = CODEC.parse_command(CODEC.ask_identity()[0], MotorCommand())
    assert CODEC.reply_frames(asked, 0xA1B2C3)[0] == frame(0x000005FE, "00 00 00 00 00 A1 B2 C3")
    kinds = [CODEC.parse_command(f, MotorCommand()).kind for f in (*CODEC.enable(), *CODEC.disable())]
    assert kinds == [CommandKind.WRITE, CommandKind.ENABLE, CommandKind.DISABLE]
    assert CODEC.parse_command(CODEC.clear_fault()[0], MotorCommand()).kind is CommandKind.CLEAR_FAULT


def test_a_motor_state_by_hand():
    state = MotorState(6.285, -10.0, 30.0, 41.5, enabled=True, faults=("over_current",))
    assert CODEC.feedback_frames(state) == (frame(0x028205FD, "BF FF 40 00 BF FF 01 9F"),)


FACTORY = {"mechanical_pos_rad": 0.0, "torque_limit_nm": 17.0}


@pytest.mark.parametrize(("model", "version"), [("RS01", "00 01 03 03"), ("RS02", "00 02 03 05")])
def test_firmware_with_false_gains_is_refused(model, version):
    codec = make_codec("robstride", 5, model)
    assert frame(0x0400FD05, "00 C4 00 00 00 00 00 00") in codec.read_setup()
    said = codec.parse(frame(0x020005FD, f"00 C4 56 {version} 00"))
    with pytest.raises(DeviceFault, match=r"1\.4167"):
        codec.with_setup({**FACTORY, said.name: said.value})


@pytest.mark.parametrize("version", ["00 02 03 06", "00 0A 00 00"])
def test_firmware_with_true_gains_is_taken(version):
    codec = make_codec("robstride", 5, "RS02")
    said = codec.parse(frame(0x020005FD, f"00 C4 56 {version} 00"))
    assert codec.with_setup({**FACTORY, said.name: said.value}) == codec


@pytest.mark.parametrize(("model", "peak_nm"), [("RS02", 60.0), ("RS03", 17.0), ("RS00", 120.0), ("RS03", 12.0)])
def test_another_model_is_known_by_its_torque_limit(model, peak_nm):
    """RS03 60 Nm, RS02 17, RS04 120; a limit that somebody lowered is refused as well."""
    codec = make_codec("robstride", 5, model)
    assert frame(0x1100FD05, "0B 70 00 00 00 00 00 00") in codec.read_setup()
    said = codec.parse(frame(0x110005FD, "0B 70 00 00" + struct.pack("<f", peak_nm).hex()))
    with pytest.raises(DeviceFault, match=f"its torque limit \\(0x700B\\) is {peak_nm:g} Nm, that of {model} is"):
        codec.with_setup({"mechanical_pos_rad": 0.0, said.name: said.value, "firmware": 0x01000000})


def test_cybergear_ranges():
    got = make_codec("robstride", 5, "CyberGear").parse(frame(0x020005FD, "FF FF FF FF FF FF 01 2C"))
    assert (got.pos_rad, got.vel_rad_s, got.torque_nm) == pytest.approx((12.5, 30.0, 12.0))


def test_an_unknown_parameter_is_dropped():
    assert CODEC.parse(frame(0x110005FD, "1B 70 00 00" + struct.pack("<f", 48.0).hex())) is None
