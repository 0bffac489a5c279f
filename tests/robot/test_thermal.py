"""The heat of motors against a fine integration, and the time that is left against running it out."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from robot.robot import load_robot
from robot.thermal import MotorHeat, ThermalFigures

FIGURES = ThermalFigures(
    ambient_c=30.0, limit_c=120.0, winding_k=200.0, housing_k=300.0, winding_s=20.0, housing_s=600.0
)
LIMIT_NM = np.array([100.0, 50.0])


def integrated(loads, step_s, figures=FIGURES, fine_s=1e-3):
    """By Euler's method: heat into the winding's element and the housing's, and out through their resistances."""
    winding_k = housing_k = 0.0
    for load in loads:
        for _ in range(round(step_s / fine_s)):
            winding_k += fine_s * (load * figures.winding_k - winding_k) / figures.winding_s
            housing_k += fine_s * (load * figures.housing_k - housing_k) / figures.housing_s
    return 30.0 + housing_k, 30.0 + housing_k + winding_k


@pytest.mark.parametrize("step_s", [0.02, 0.5, 5.0])
def test_any_step_is_exact(step_s):
    shares = np.random.default_rng(0).uniform(-1.0, 1.0, round(20.0 / step_s))
    heat = MotorHeat(LIMIT_NM, FIGURES)
    for share in shares:
        heat.step(share * LIMIT_NM, step_s)
    housing_c, winding_c = integrated(shares**2, step_s)
    np.testing.assert_allclose(heat.housing_c, housing_c, atol=0.01)
    np.testing.assert_allclose(heat.winding_c, winding_c, atol=0.03)


def test_what_may_be_held_for_ever_ends_at_the_limit():
    """0.4 of the torque limit, of the robot's own figures."""
    robot = load_robot()
    heat = MotorHeat(robot.torque_limit_nm, robot.thermal)
    heat.step(0.4 * robot.torque_limit_nm, 1e6)
    np.testing.assert_allclose(heat.winding_c, 120.0)


def test_the_time_left_is_when_the_limit_is_reached():
    heat = MotorHeat(LIMIT_NM, FIGURES)
    load_nm = LIMIT_NM * [0.6, 0.3]
    for _ in range(100):
        heat.step(load_nm, 1.0)
    left_s = heat.left_s(120.0)
    assert left_s[1] == np.inf and left_s[0] > 10.0
    assert heat.left_s(115.0)[0] < left_s[0]
    heat.step(load_nm, float(left_s[0]))
    assert heat.winding_c[0] == pytest.approx(120.0, abs=1.0)
    heat.step(load_nm, 60.0)
    assert heat.left_s(115.0)[0] == heat.left_s(120.0)[0] == 0.0


def test_a_measured_housing_is_believed_where_it_is_known():
    heat = MotorHeat(LIMIT_NM, FIGURES)
    heat.step(np.zeros(2), 1.0, np.array([70.0, np.nan]))
    np.testing.assert_allclose(heat.housing_c, [70.0, 30.0])
    np.testing.assert_allclose(heat.winding_c, [70.0, 30.0])


@pytest.mark.parametrize(("field", "value"), [("winding_s", 0.0), ("housing_k", -1.0), ("limit_c", 30.0)])
def test_figures_that_cannot_be_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        replace(FIGURES, **{field: value})
