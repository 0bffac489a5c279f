"""A motor's torque against what it was asked for: models that read gains by other ranges are found while they move."""

import time

import numpy as np
import pytest

from hal.can.codec import MotorCommand
from hal.can.codecs import robstride
from hal.can.robot_file import MotorEntry
from hal.can.setup import bring_back, prepare, switch_on
from hal.can.torque_check import ANSWERS, TorqueCheck
from tests.hal.can.rig import ELBOW, G1, Rig, index, motor, robot_file

MOTEUS = {"kp_nm_per_turn": 800.0, "kd_nm_s_per_turn": 60.0, "torque_nm": 30.0}
MODELS = {
    "damiao": ("DM4340", {}),
    "robstride": ("RS06", {}),
    "cubemars": ("AK70-10", {"keeps_zero": True}),
    "moteus": ("r4", MOTEUS),
}


def elbow(codec: str, model: str, **options: object) -> MotorEntry:
    return motor(ELBOW, 3, codec=codec, model=model, options=options)


def against_a_stop(file: MotorEntry, built: MotorEntry | None = None) -> Rig:
    """A driven elbow that cannot move. built: the motor that is there; its torque limit was set to the file's."""
    rig = Rig(robot_file(file), built=robot_file(built or file))
    rig.robot.lower_rad[:] = rig.robot.upper_rad[:] = rig.robot.pos_rad
    rig.motors[0].values[robstride.TORQUE_LIMIT_NM] = rig.bus.motors[0].codec.model.torque_nm
    prepare(rig.bus, rig.bus.motors[0], rig.file.watchdog_s)
    switch_on(rig.bus, rig.bus.motors[0])
    rig.begin()
    return rig


def push(rig: Rig, rounds: int = ANSWERS + 30) -> None:
    """2 Nm: 20 Nm/rad, 0.1 rad from the target."""
    rig.track(rig.robot.pos_rad + 0.1, kp=20.0)
    rig.round()
    time.sleep(0.005)
    rig.round(rounds)


@pytest.mark.real_time
@pytest.mark.parametrize(
    ("model", "built", "times"),
    [("RS02", "RS03", 10 * 17 / 60), ("RS06", "RS02", 36 / 17 / 10), ("RS04", "RS03", 120 / 60)],
)
def test_a_robstride_of_another_model_is_a_fault_by_name(model: str, built: str, times: float) -> None:
    """Its gains are those of the file by the ratio of the ranges of kp, its torque reads by that of the torques."""
    rig = against_a_stop(elbow("robstride", model), elbow("robstride", built))
    push(rig)
    (shown,) = rig.shown
    assert shown.startswith(f"motor_fault:{ELBOW}: gives ") and "another model than the robot file's" in shown
    assert float(shown.split("gives ")[1].split()[0]) == pytest.approx(times, rel=0.06)
    assert rig.told(ELBOW)[2] == 0.0, "a motor with a fault is damped"


@pytest.mark.real_time
def test_the_operators_word_judges_it_anew() -> None:
    rig = against_a_stop(elbow("robstride", "RS02"), elbow("robstride", "RS03"))
    push(rig)
    assert rig.shown
    bring_back(rig.bus, rig.bus.motors[0], rig.file.watchdog_s, on=True)
    push(rig, ANSWERS // 2)
    assert rig.shown == ()
    push(rig)
    assert rig.shown


@pytest.mark.real_time
@pytest.mark.parametrize("codec", MODELS)
def test_the_right_motor_passes_at_rest_and_swinging(codec: str) -> None:
    if codec == "moteus":
        pytest.importorskip("moteus")
    model, options = MODELS[codec]
    rig = against_a_stop(elbow(codec, model, **options))
    push(rig, 2 * ANSWERS)
    assert rig.shown == ()
    switch_on(rig.bus, rig.bus.motors[0])
    rig.robot.lower_rad, rig.robot.upper_rad = G1.pos_lower_rad, G1.pos_upper_rad
    for i in range(2 * ANSWERS):
        rig.track(G1.default_pos_rad + 0.4 * np.sin(0.3 * i), kp=20.0)
        rig.round(4)
    assert rig.shown == () and abs(rig.robot.vel_rad_s[index(ELBOW)]) > 0.0


def judged(asked_nm: float, given_nm: float, answers: int = ANSWERS) -> str | None:
    """Of a motor of 20 Nm."""
    check, command = TorqueCheck(20.0), MotorCommand(tau_nm=asked_nm)
    for _ in range(1 + answers):
        check.hear(command, 0.0, 0.0, given_nm)
    return check.problem


def test_what_tells_nothing_is_not_judged() -> None:
    """Less than 1 Nm asked and measured, more than 10 Nm asked, or fewer than 50 answers after the first."""
    assert judged(2.0, 20.0) is not None and judged(2.0, 20.0, ANSWERS - 1) is None
    assert judged(0.9, 0.1) is None and judged(0.0, 3.0) is not None
    assert judged(11.0, 1.0) is None and judged(9.0, 1.0) is not None
    assert judged(2.0, 3.5) is None and judged(2.0, 1.2) is None


def test_the_first_answer_to_a_new_command_was_measured_before() -> None:
    check = TorqueCheck(20.0)
    for _ in range(2 * ANSWERS):
        check.hear(MotorCommand(tau_nm=2.0), 0.0, 0.0, 0.0)
    assert check.problem is None


def test_damping_counts_by_its_sign_and_a_target_speed_too() -> None:
    """kp 10 at 0.5 rad, kd 2 at 1 rad/s against 3: 5 + 4 Nm; a motor that gave 5 - 4 would be refused."""
    command = MotorCommand(q_rad=1.0, dq_rad_s=3.0, kp=10.0, kd=2.0)
    for given_nm, fits in ((9.0, True), (1.0, False)):
        check = TorqueCheck(20.0)
        for _ in range(1 + ANSWERS):
            check.hear(command, 0.5, 1.0, given_nm)
        assert (check.problem is None) is fits
