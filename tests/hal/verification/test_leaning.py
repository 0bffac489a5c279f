"""What an IMU tells of a base that is leaned by hand, by states with known angles."""

import math
import re
from collections.abc import Callable

import numpy as np
import pytest

from hal.contract.types import RobotState
from hal.verification.leaning import lean_problem
from hal.verification.options import load_verify_options

OPTIONS = load_verify_options()
PERIOD_S, REST = 0.02, 25
NONE = np.zeros(1)


def state(time_s: float, pitch_rad: float, rate_rad_s: float) -> RobotState:
    """Of a base that leans forwards by an angle, its accelerometer showing nothing but gravity."""
    return RobotState(
        time_s=time_s,
        joint_pos_rad=NONE,
        joint_vel_rad_s=NONE,
        joint_torque_nm=NONE,
        joint_age_s=NONE,
        imu_quat_wxyz=np.array([math.cos(pitch_rad / 2), 0.0, math.sin(pitch_rad / 2), 0.0]),
        imu_ang_vel_b=np.array([0.0, rate_rad_s, 0.0]),
        imu_acc_b=9.81 * np.array([-math.sin(pitch_rad), 0.0, math.cos(pitch_rad)]),
        imu_age_s=0.0,
    )


def problem(swing_rad_s: float, gyro: Callable[[float], float]) -> str | None:
    """Half a second of rest, in which the base swings on its ropes; 1.5 s of leaning by 0.25 rad; rest."""

    def pitch(time_s: float) -> float:
        if time_s <= 0.5:
            return swing_rad_s * time_s
        return swing_rad_s * 0.5 + 0.125 * (1.0 - math.cos(math.pi * min(1.0, (time_s - 0.5) / 1.5)))

    def rate(time_s: float) -> float:
        return (pitch(time_s + 1e-6) - pitch(time_s - 1e-6)) / 2e-6

    states = [state(t, pitch(t), gyro(rate(t))) for t in PERIOD_S * np.arange(125)]
    return lean_problem("forwards", states[: REST + 1], states[REST:], states[-REST:], OPTIONS)


@pytest.mark.parametrize("swing_rad_s", [0.0, 0.05, -0.09])
@pytest.mark.parametrize("bias_rad_s", [0.0, 0.01, -0.01])
def test_a_right_imu_passes_though_the_base_swings_and_its_gyro_is_off(swing_rad_s: float, bias_rad_s: float) -> None:
    assert problem(swing_rad_s, lambda rate: rate + bias_rad_s) is None


@pytest.mark.parametrize(("scale", "apart"), [(-1.0, "3.14"), (0.6, "0.00"), (1.4, "0.00"), (math.pi / 180, "0.00")])
def test_a_wrong_gyro_is_refused_though_the_base_swings(scale: float, apart: str) -> None:
    for swing_rad_s in (0.0, 0.02, -0.02):
        found = problem(swing_rad_s, lambda rate: scale * rate)
        assert found is not None and f"acceleration tells of, {apart} rad apart" in found
        assert (told := re.search(r"its gyro tells of (\S+) times", found)) is not None
        assert float(told[1]) == pytest.approx(abs(scale), abs=0.05)
