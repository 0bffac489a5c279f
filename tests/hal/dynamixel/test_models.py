"""The servos' law, against figures worked out by hand from the maker's table."""

import math

import numpy as np
import pytest

from core.errors import InputError
from hal.dynamixel.models import Law, find_model, known_models

# XM430-W350 at 12 V: 4.1 Nm at 2.3 A, 2.69 mA a count: 4.1 / 2.3 * 0.00269 = 4.7952e-3 Nm a count. 4096 / 2 pi =
# 651.899 counts a radian.
XM430_COUNT_NM = 4.7952e-3


def test_current_mode_by_hand() -> None:
    law = Law([find_model("XM430-W350")], 12.0)
    # P 800: 6.25 counts of current a count of error -> 6.25 * 651.899 * 4.7952e-3 = 19.537 Nm/rad.
    assert law.kp(np.array([800])) == pytest.approx([19.537], rel=1e-4)
    # D 1600: 100 counts of current for a count a millisecond -> 100 * 0.651899 * 4.7952e-3 = 0.31260 Nm s/rad.
    assert law.kd(np.array([1600])) == pytest.approx([0.31260], rel=1e-4)
    assert law.torque_unit == pytest.approx([XM430_COUNT_NM], rel=1e-4)
    assert law.current_counts(np.array([2.0])).tolist() == [417]
    assert law.limit_max == pytest.approx([4.1])  # 1193 counts would be 5.72 Nm: the motor gives out before


def test_duty_mode_by_hand() -> None:
    law = Law([find_model("XL430-W250")], 12.0)
    # P 800: 6.25 counts of 885 a count of error -> 1.5 / 885 * 6.25 * 651.899 = 6.9057 Nm/rad.
    assert law.kp(np.array([800])) == pytest.approx([6.9057], rel=1e-4)
    # Back-EMF: 1.5 Nm over 61 rpm = 6.3879 rad/s: 0.23482 Nm s/rad.
    assert law.kd(np.array([0])) == pytest.approx([0.23482], rel=1e-4)
    assert law.current_counts(np.array([1.0])).tolist() == [0]
    assert law.torque_unit == pytest.approx([1.5e-3])


def test_the_supply_moves_the_duty_mode_only() -> None:
    models = [find_model("XM430-W350"), find_model("XL430-W250")]
    at_12, at_10 = Law(models, 12.0), Law(models, 10.0)
    assert at_10.kp_unit / at_12.kp_unit == pytest.approx([1.0, 10 / 12])
    assert at_10.kd_own == pytest.approx(at_12.kd_own)  # torque and speed fall together
    assert at_10.limit_max[1] == pytest.approx(1.25)


def test_gains_are_rounded_and_kept_in_range() -> None:
    law = Law([find_model("XM430-W350"), find_model("XL430-W250")], 12.0)
    p = law.p_counts(np.array([19.537, 1e6]))
    assert p.tolist() == [800, 16383]
    assert law.p_counts(np.array([0.0, 0.0])).tolist() == [0, 0]
    # The XL430 brakes by itself more than is asked for: D stays 0.
    assert law.d_counts(np.array([0.3126, 0.1])).tolist() == [1600, 0]
    asked = np.array([7.0, 3.0])
    assert law.kp(law.p_counts(asked)) == pytest.approx(asked, abs=0.5 * law.kp_unit.max())


def test_a_stand_in_keeps_the_electronics() -> None:
    servo = find_model("XM540-W270").stand_in("strong", 139.0, 20.0)
    assert servo.number == 1120
    law = Law([servo], 12.0)
    assert law.torque_unit == pytest.approx([139 / 4.4 * 0.00269])
    assert law.limit_max == pytest.approx([139.0])
    assert servo.no_load_rpm == pytest.approx(20 * 60 / (2 * math.pi))


def test_every_model_is_usable() -> None:
    models = known_models()
    assert len({model.number for model in models.values()}) == len(models) == 16
    for model in models.values():
        assert model.operating_mode == (5 if model.has_current else 4)
        assert model.stall_nm > 0 and model.stall_a > 0 and model.no_load_rpm > 0
        assert bool(model.current_max) == model.has_current


def test_an_unknown_model_names_the_known_ones() -> None:
    with pytest.raises(InputError, match="XM430-W350"):
        find_model("XM430")
