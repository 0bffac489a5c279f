"""What the slowed wires of `make test` are slower in, as each wire's own loader reads it."""

from pathlib import Path

import pytest

from core.config import load_options
from hal.can.robot_file import load_robot_file
from hal.dds.options import DdsOptions
from hal.dynamixel.robot_file import load_dynamixel
from hal.open import wire_config
from tests.hal.conformance.pace import slowed


def test_rates_fall_and_limits_rise_by_the_factor(tmp_path: Path) -> None:
    can = load_robot_file(slowed("can", wire_config("can"), 2.5, tmp_path))
    assert (can.rate_hz, can.watchdog_s) == pytest.approx((80.0, 0.25))
    dynamixel = load_dynamixel(slowed("dynamixel", wire_config("dynamixel"), 2.5, tmp_path))
    assert (dynamixel.rate_hz, dynamixel.watchdog_s) == pytest.approx((40.0, 0.5))
    dds = load_options(DdsOptions, slowed("dds", wire_config("dds"), 2.5, tmp_path))
    assert (dds.command_hz, dds.emulator.state_hz, dds.link_timeout_s) == pytest.approx((200.0, 200.0, 0.25))
