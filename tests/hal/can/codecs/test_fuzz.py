"""100,000 random and mutated frames per protocol, both ways: no crash, no state that the frame does not hold.

What a frame may hold is decided here a second time, from the byte tables alone.
"""

import math
import struct

import numpy as np
import pytest

from hal.can.codec import MotorCommand, MotorState
from hal.can.frame import Frame
from hal.can.messages import Feedback
from tests.hal.can.codecs.rigs import CODECS

COUNT = 100_000
HELD = MotorCommand(0.1, 0.0, 5.0, 0.5, 0.0)
SLACK = 1 + 1e-6


def genuine(codec):
    state = MotorState(0.4, -1.0, 2.0, 40.0, enabled=True, faults=("over_current",))
    target = MotorCommand(0.3, 0.1, 5.0, 0.5, 0.1)
    answers = [
        reply
        for frame in (*codec.read_setup(), *codec.read_watchdog(), *codec.set_watchdog(0.1))
        for reply in codec.reply_frames(codec.parse_command(frame, HELD), 1.0)
    ]
    return [
        *codec.feedback_frames(state),
        *codec.command(target),
        *codec.damping(1.0),
        *codec.enable(),
        *codec.disable(),
        *codec.set_zero(),
        *codec.request_state(),
        *codec.set_watchdog(0.1),
        *codec.read_watchdog(),
        *codec.read_setup(),
        *answers,
    ]


def frames(codec, seed):
    """Half of them random with ids near the right ones, half genuine frames with a few bits, or the length, changed."""
    rng = np.random.default_rng(seed)
    true = genuine(codec)
    pool = rng.integers(0, 256, COUNT * 64 + 64, dtype=np.uint8).tobytes()
    pick = rng.integers(0, len(true), COUNT).tolist()
    lengths = rng.choice(
        [0, 3, 4, 6, 7, 8, 8, 8, 8, 12, 24, 48, 64] if codec.fd else [0, 4, 6, 7, 8, 8, 8, 8], COUNT
    ).tolist()
    flips = rng.integers(0, 2**29, (COUNT, 3)).tolist()
    luck = rng.random((COUNT, 4)).tolist()
    for i in range(COUNT):
        base = true[pick[i]]
        identifier, extended, fd, remote = base.arbitration_id, base.extended, base.fd, base.remote
        if luck[i][0] < 0.3:
            identifier ^= 1 << flips[i][0] % (29 if extended else 11)
        if luck[i][0] < 0.03:
            extended, remote, fd = luck[i][1] < 0.5, luck[i][2] < 0.5, luck[i][3] < 0.5
        if i % 2:
            data = pool[i * 64 : i * 64 + lengths[i]]
        else:
            data = bytearray(base.data)
            for flip in flips[i][: int(luck[i][1] * 4)]:
                if data:
                    data[flip % len(data)] ^= 1 << flip // 64 % 8
            data = bytes(data[: len(data) - 1] if luck[i][2] < 0.05 else data)
        yield Frame(identifier, data, extended, fd, remote)


def mit_state(codec, frame, lengths):
    addressed = frame.arbitration_id == codec.host_id and not frame.extended and not frame.remote
    return addressed and len(frame.data) in lengths


def damiao_holds_state(codec, frame):
    data = frame.data
    if not mit_state(codec, frame, (8,)):
        return False
    return data[0] % 16 == codec.motor_id and not (
        data[1] < 16 and data[2] in (0x33, 0x55, 0xAA, 0xCC) and data[3] < 82
    )


def cubemars_holds_state(codec, frame):
    return mit_state(codec, frame, (6, 8)) and frame.data[0] == codec.motor_id


def robstride_holds_state(codec, frame):
    if not frame.extended or frame.remote or len(frame.data) != 8:
        return False
    kind, sender, receiver = frame.arbitration_id >> 24, frame.arbitration_id >> 8 & 255, frame.arbitration_id & 255
    return kind in (2, 21) and (sender, receiver) == (codec.motor_id, codec.host_id)


def odrive_holds_state(codec, frame):
    if frame.extended or frame.remote or len(frame.data) != 8 or frame.arbitration_id >> 5 != codec.motor_id:
        return False
    return frame.arbitration_id & 31 in (0x01, 0x03, 0x09, 0x15, 0x17, 0x1C)


def moteus_holds_state(codec, frame):
    addressed = (frame.arbitration_id, frame.extended) == (codec.motor_id << 8, False)
    return addressed and frame.fd and not frame.remote and any(byte & 0xF0 == 0x20 for byte in frame.data)


HOLDS_STATE = {
    "damiao": damiao_holds_state,
    "robstride": robstride_holds_state,
    "cubemars": cubemars_holds_state,
    "odrive": odrive_holds_state,
    "moteus": moteus_holds_state,
}


def check_state(codec, frame, got):
    assert HOLDS_STATE[codec.name](codec, frame), frame
    assert got.motor_id == codec.motor_id
    if codec.name in ("odrive", "moteus"):
        return
    model = codec.model
    values = ((got.pos_rad, model.pos_rad), (got.vel_rad_s, model.vel_rad_s), (got.torque_nm, model.torque_nm))
    assert all(value is None or abs(value) <= limit * SLACK for value, limit in values), frame


def check_command(codec, frame, asked):
    assert not frame.remote or asked.command is None
    command = asked.command
    if command is None:
        return
    values = (command.q_rad, command.dq_rad_s, command.kp, command.kd, command.tau_nm)
    assert all(map(math.isfinite, values)), frame
    assert min(command.kp, command.kd) >= 0, frame


@pytest.mark.parametrize("name", CODECS)
def test_no_frame_crashes_a_codec_or_makes_it_invent_state(name):
    codec = CODECS[name]
    states = commands = 0
    for frame in frames(codec, seed=11):
        got = codec.parse(frame)
        if isinstance(got, Feedback):
            check_state(codec, frame, got)
            states += 1
        asked = codec.parse_command(frame, HELD)
        if asked is not None:
            check_command(codec, frame, asked)
            commands += 1
        found = codec.recognise(frame)
        assert found is None or found.codec == name
    assert states > 2_000
    assert commands > 2_000


def test_the_values_of_a_state_are_those_of_its_bytes():
    """ODrive's floats, bit for bit, whatever they are."""
    codec = CODECS["odrive"]
    rng = np.random.default_rng(3)
    for data in rng.integers(0, 256, (2_000, 8), dtype=np.uint8):
        got = codec.parse(Frame(codec.motor_id << 5 | 0x09, data.tobytes()))
        turns = struct.unpack("<ff", data.tobytes())
        np.testing.assert_allclose([got.pos_rad, got.vel_rad_s], np.multiply(turns, 2 * math.pi), rtol=1e-12)
