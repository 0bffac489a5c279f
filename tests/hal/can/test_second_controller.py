"""Commands that we did not send, heard while the robot runs."""

from dataclasses import replace

import pytest

from hal.can.codec import MotorCommand
from hal.can.setup import prepare, switch_on
from tests.hal.can.codecs.rigs import CODECS
from tests.hal.can.rig import HIP, KNEE, Rig, motor, robot_file

OPTIONS = {
    "odrive": {"enable_watchdog_endpoint": 0x123, "watchdog_timeout_endpoint": 0x124},
    "moteus": {"kp_nm_per_turn": 800.0, "kd_nm_s_per_turn": 60.0, "torque_nm": 100.0},
    "cubemars": {"keeps_zero": True},
}
MODELS = {"damiao": "DM10010L", "robstride": "RS04", "cubemars": "AK10-9", "odrive": "S1", "moteus": "r4"}


def running(codec: str) -> Rig:
    """Two motors of one protocol, damped; the rounds' own frames and answers are no news."""
    motors = [
        motor(joint, i, codec=codec, model=MODELS[codec], options=OPTIONS.get(codec, {}))
        for i, joint in ((3, HIP), (4, KNEE))
    ]
    rig = Rig(robot_file(*motors))
    for one in rig.bus.motors:
        prepare(rig.bus, one, rig.file.watchdog_s)
        if one.codec.cyclic_period_s is None:
            switch_on(rig.bus, one)
    rig.begin()
    rig.damp()
    rig.round(5)
    assert rig.shown == ()
    return rig


@pytest.mark.parametrize("codec", CODECS)
def test_a_second_controller_is_seen_at_once_and_until_the_operators_word(codec: str) -> None:
    rig = running(codec)
    foreign = rig.bus.motors[1].codec.command(MotorCommand(q_rad=0.2, kp=20.0, kd=1.0))
    for frame in foreign:
        rig.link.say(frame)
    rig.round()
    assert rig.shown == (f"second controller: somebody else commands {KNEE}",)
    rig.round(3)
    assert rig.shown != ()
    rig.bus.mend()
    rig.round(3)
    assert rig.shown == ()


@pytest.mark.parametrize("codec", CODECS)
def test_switching_a_motor_by_another_hand_is_seen_as_well(codec: str) -> None:
    rig = running(codec)
    for frame in rig.bus.motors[0].codec.disable():
        rig.link.say(frame)
    rig.round()
    assert f"second controller: somebody else commands {HIP}" in rig.shown


@pytest.mark.parametrize("codec", [name for name in CODECS if name not in ("cubemars", "robstride")])
def test_a_question_by_another_hand_is_none(codec: str) -> None:
    """CubeMars and RobStride can only be asked by switching them off."""
    rig = running(codec)
    for frame in (*rig.bus.motors[0].codec.request_state(), *rig.bus.motors[0].codec.ask_identity()):
        rig.link.say(frame)
    rig.round()
    assert rig.shown == ()


def test_a_moteus_commanded_from_another_address() -> None:
    pytest.importorskip("moteus")
    rig = running("moteus")

    (frame,) = rig.bus.motors[0].codec.command(MotorCommand(q_rad=0.2, kp=20.0, kd=1.0))
    rig.link.say(replace(frame, arbitration_id=frame.arbitration_id | 0x500))
    rig.round()
    assert rig.shown == (f"second controller: somebody else commands {HIP}",)
