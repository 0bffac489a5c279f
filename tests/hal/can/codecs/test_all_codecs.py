"""What holds for every protocol: round trips, range ends, refusals, ids."""

import dataclasses
import math

import numpy as np
import pytest

from core.errors import InputError
from hal.can.codec import CommandKind, MotorCommand, MotorState
from hal.can.codecs import CODECS as CLASSES
from hal.can.codecs import make_codec
from hal.can.codecs.scaling import from_code, to_code
from hal.can.frame import FD_LENGTHS, Frame, IdFilter
from tests.hal.can.codecs.rigs import CODECS

STEPS = {
    "damiao": (2**16, 2**12),
    "cubemars": (2**16, 2**12),
    "robstride": (2**16, 2**16),
    "odrive": None,
    "moteus": None,
}


@pytest.fixture(params=CODECS)
def codec(request):
    return CODECS[request.param]


def received(codec, command, held=None):
    held = MotorCommand() if held is None else held
    for frame in codec.command(command):
        held = codec.parse_command(frame, held).command
    return held


def felt(codec, state):
    got = {}
    for frame in codec.feedback_frames(state):
        message = codec.parse(frame)
        names = ("pos_rad", "vel_rad_s", "torque_nm", "temperature_c", "faults", "enabled")
        got |= {name: getattr(message, name) for name in names if getattr(message, name) is not None}
    return got


def half_step(codec, span, wide=False):
    steps = STEPS[codec.name]
    if steps is None:
        return 0.004 if not wide else 1e-4
    return span / (steps[0 if wide else 1] - 1) / 2 * (1 + 1e-9)


def test_the_motor_reads_what_the_host_wrote(codec):
    rng = np.random.default_rng(1)
    model = codec.model
    pos = min(model.pos_rad, 12.0)
    for _ in range(300):
        q, dq, tau = rng.uniform(-1, 1, 3) * (pos, min(model.vel_rad_s, 60.0), model.torque_nm)
        kd = float(rng.uniform(0.1, 1.0)) * min(model.kd, 5.0)
        kp = float(rng.uniform(0.1, 1.0)) * min(model.kp, 90.0)
        if codec.name == "moteus":
            kd = min(kd, kp / model.kp * model.kd)
        got = received(codec, MotorCommand(q, dq, kp, kd, tau))
        assert got.q_rad == pytest.approx(q, abs=half_step(codec, 2 * model.pos_rad, wide=True))
        assert got.dq_rad_s == pytest.approx(dq, abs=half_step(codec, 2 * model.vel_rad_s))
        assert got.kp == pytest.approx(kp, abs=half_step(codec, model.kp))
        assert got.kd == pytest.approx(kd, abs=half_step(codec, model.kd))
        assert got.tau_nm == pytest.approx(tau, abs=half_step(codec, 2 * model.torque_nm))


def test_the_host_reads_what_the_motor_wrote(codec):
    rng = np.random.default_rng(2)
    model = codec.model
    for _ in range(300):
        pos, vel, torque = rng.uniform(-1, 1, 3) * (min(model.pos_rad, 12.0), model.vel_rad_s, model.torque_nm)
        got = felt(codec, MotorState(pos, vel, torque, 41.0, enabled=True))
        assert got["pos_rad"] == pytest.approx(pos, abs=half_step(codec, 2 * model.pos_rad, wide=True))
        assert got["vel_rad_s"] == pytest.approx(vel, abs=half_step(codec, 2 * model.vel_rad_s))
        assert got["torque_nm"] == pytest.approx(torque, abs=half_step(codec, 2 * model.torque_nm))
        assert (got["temperature_c"], got["faults"]) == (41.0, ())
        assert got.get("enabled", True) is True


def test_nothing_leaves_the_ranges(codec):
    model = codec.model
    for sign in (-1.0, 1.0):
        got = received(codec, MotorCommand(sign * 1e12, sign * 1e12, 1e12, 1e12, sign * 1e12))
        assert abs(got.q_rad) == pytest.approx(model.pos_rad, rel=1e-6)
        assert math.copysign(1, got.q_rad) == sign
        assert abs(got.dq_rad_s) <= model.vel_rad_s * (1 + 1e-6)
        assert abs(got.tau_nm) <= model.torque_nm * (1 + 1e-6)
        assert 0 <= got.kp <= model.kp * (1 + 1e-6)
        assert 0 <= got.kd <= model.kd * (1 + 1e-6)


def test_damping_has_no_stiffness_and_keeps_its_damping(codec):
    kd = 0.3 * codec.model.kd
    held = MotorCommand(1.0, 0.0, 0.5 * min(codec.model.kp, 90.0), kd, 0.0)
    for frame in codec.damping(kd, held):
        held = codec.parse_command(frame, held).command
    assert held.kp == 0
    assert held.kd == pytest.approx(kd, rel=1e-3)
    assert abs(held.dq_rad_s) <= half_step(codec, 2 * codec.model.vel_rad_s)
    assert abs(held.tau_nm) <= half_step(codec, 2 * codec.model.torque_nm)


def test_enabling_asks_for_no_torque(codec):
    held = MotorCommand()
    for frame in codec.enable():
        asked = codec.parse_command(frame, held)
        held = held if asked is None or asked.command is None else asked.command
    assert (held.kp, held.kd, held.tau_nm) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("field", ["q_rad", "dq_rad_s", "kp", "kd", "tau_nm"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_never_packed(field, value):
    with pytest.raises(ValueError, match="finite"):
        MotorCommand(**{field: value})


@pytest.mark.parametrize("field", ["kp", "kd"])
def test_negative_gains_are_never_packed(field):
    with pytest.raises(ValueError, match="at least 0"):
        MotorCommand(**{field: -1e-9})


@pytest.mark.parametrize("bits", [12, 16])
def test_codes_by_hand(bits):
    full = 2**bits - 1
    codes = [to_code(value, -3.0, 3.0, bits) for value in (-4.0, -3.0, 3.0, 4.0)]
    assert codes == [0, 0, full, full]
    assert (from_code(0, -3.0, 3.0, bits), from_code(full, -3.0, 3.0, bits)) == (-3.0, 3.0)
    assert all(to_code(from_code(code, -3.0, 3.0, bits), -3.0, 3.0, bits) == code for code in range(0, full + 1, 7))


def test_every_frame_could_be_sent(codec):
    target = MotorCommand(0.3, 0.1, 5.0, 0.5, 0.1)
    state = MotorState(0.1, 0.2, 0.3)
    frames = (
        *codec.enable(),
        *codec.disable(),
        *codec.clear_fault(),
        *codec.set_zero(),
        *codec.request_state(),
        *codec.command(target),
        *codec.damping(1.0),
        *codec.set_watchdog(0.1),
        *codec.read_watchdog(),
        *codec.read_setup(),
        *codec.feedback_frames(state),
        *codec.probe(codec.motor_id, codec.host_id),
    )
    for frame in frames:
        assert 0 <= frame.arbitration_id <= (0x1FFFFFFF if frame.extended else 0x7FF)
        assert frame.fd == codec.fd
        assert len(frame.data) in (FD_LENGTHS if codec.fd else range(9))


def test_answers_pass_the_filter_and_commands_of_the_host_are_no_state(codec):
    for frame in codec.feedback_frames(MotorState(0.1, 0.2, 0.3)):
        assert codec.reply_filter.matches(frame)
        assert any(occupied.matches(frame) for occupied in codec.occupied)
    for frame in (*codec.command(MotorCommand(0.3, 0.1, 5.0, 0.5, 0.1)), *codec.enable(), *codec.disable()):
        assert codec.parse(frame) is None


def test_a_switch_is_read_as_such(codec):
    kinds = [codec.parse_command(frame, MotorCommand()).kind for frame in codec.disable()]
    assert kinds == [CommandKind.DISABLE]


def test_another_motor_of_the_protocol_is_not_mistaken(codec):
    other = dataclasses.replace(codec, motor_id=6, host_id=0x16 if codec.name == "damiao" else codec.host_id)
    if codec.name == "cubemars":
        other = dataclasses.replace(other, host_id=6)
    for frame in other.feedback_frames(MotorState(0.1, 0.2, 0.3)):
        assert codec.parse(frame) is None
        assert not codec.reply_filter.matches(frame)
    for frame in other.command(MotorCommand(0.3, 0.1, 5.0, 0.5, 0.1)):
        assert codec.parse_command(frame, MotorCommand()) is None
    assert not any(a.overlaps(b) for a in codec.occupied for b in other.occupied)


def test_overlaps():
    assert IdFilter(0x010, 0x7FF, False).overlaps(IdFilter(0x000, 0x7E0, False))
    assert not IdFilter(0x020, 0x7FF, False).overlaps(IdFilter(0x000, 0x7E0, False))
    assert not IdFilter(0x010, 0x7FF, False).overlaps(IdFilter(0x010, 0x7FF, True))
    assert IdFilter(0x010, 0x7FF, None).matches(Frame(0x010, extended=True))


@pytest.mark.parametrize("name", CLASSES)
def test_each_module_states_its_damping_frame_and_its_watchdog(name):
    text = __import__(f"hal.can.codecs.{name}", fromlist=["_"]).__doc__
    assert "Damping frame" in text
    assert "Watchdog:" in text


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        (("canopen", 1, "x"), {}, "servo protocol, got canopen, expected one of damiao"),
        (("damiao", 1, "DM9999"), {}, "damiao model, got 'DM9999', expected one of DM3507"),
        (("damiao", 0, "DM4310"), {}, "damiao motor id, got 0, expected an integer from 1 to 255"),
        (("damiao", "1", "DM4310"), {}, "damiao motor id, got '1'"),
        (("damiao", 1, "DM4310"), {"firmware": "1"}, "damiao options, got firmware, expected none"),
        (("damiao", 1, "DM4310"), {"host_id": 0x7FF}, "damiao host id, got 2047"),
        (("robstride", 0xFD, "RS03"), {}, "robstride motor id, got 253"),
        (("robstride", 1, "RS02"), {"firmware": "new"}, "robstride options, got firmware, expected none"),
        (("cubemars", 1, "AK80-9"), {"keeps_zero": 1}, "cubemars keeps_zero, got 1, expected true or false"),
        (("cubemars", 1, "AK80-9"), {"host_id": True}, "cubemars host id, got True"),
        (("odrive", 0, "S1"), {}, "odrive motor id (node), got 0"),
        (("odrive", 1, "S1"), {"endpoint": 4}, "odrive options, got endpoint"),
    ],
)
def test_a_wrong_line_in_a_robot_file_is_named(arguments, options, message):
    with pytest.raises(InputError) as error:
        make_codec(*arguments, **options)
    assert message in str(error.value)
