"""The emulated servo keeps the maker's rules, so that a driver that breaks them is found out."""

import numpy as np
import pytest

from hal.contract.joint_map import JointMap
from hal.dynamixel import protocol2 as p2
from hal.dynamixel import registers as r
from hal.dynamixel.models import find_model
from hal.emulator.dynamixel_servo import EmulatedServo


def servo(model: str = "XM430-W350", *, gear: float = 1.0, direction: int = 1) -> EmulatedServo:
    return EmulatedServo(7, "knee", find_model(model), JointMap.of(["knee"], [direction], [0.0], [gear]), 12.0)


class Recorder:
    """Stands for the robot: what the servo has it do."""

    def command(self, *values: float) -> None:
        self.last = values

    def slack(self, joint: int) -> None:
        self.last = None


def test_wakes_up_without_torque_and_within_one_turn() -> None:
    one = servo()
    one.power_up(round(one.true_counts(4.0)))  # 4 rad above the middle: 4656 counts, a turn too many
    one.measure(4.0, 0.0, 0.0, 0.0)
    assert one.get(r.PRESENT_POSITION) == 2048 + 2608 - 4096
    assert one.get(r.TORQUE_ENABLE) == 0
    robot = Recorder()
    one.drive(robot, 0)
    assert robot.last is None


def test_eeprom_is_locked_while_the_torque_is_on() -> None:
    one = servo()
    assert one.write(9, b"\0") == 0
    assert one.write(64, b"\1") == 0
    assert one.write(9, b"\1") == p2.BAD_ACCESS
    assert one.get(r.RETURN_DELAY) == 0


def test_eeprom_survives_a_restart_and_ram_does_not() -> None:
    one = servo()
    one.write(11, b"\5")
    one.write(84, (123).to_bytes(2, "little"))
    one.power_up(2048)
    assert (one.get(r.OPERATING_MODE), one.get(r.POSITION_P)) == (5, 800)


def test_another_mode_resets_the_gains() -> None:
    one = servo()
    one.write(80, b"\x10\x00\x00\x00\x20\x00")
    one.write(102, (100).to_bytes(2, "little"))
    one.write(11, b"\5")
    assert (one.get(r.POSITION_D), one.get(r.POSITION_P), one.get(r.GOAL_CURRENT)) == (0, 800, 1193)


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (0, b"\1\0", p2.BAD_ACCESS),
        (126, b"\0\0", p2.BAD_ACCESS),
        (116, b"\0\0", p2.BAD_ACCESS),
        (80, b"\xff\xff", p2.BAD_RANGE),
        (116, (2_000_000).to_bytes(4, "little"), p2.BAD_RANGE),
        (102, (1194).to_bytes(2, "little"), p2.BAD_LIMIT),
        (98, b"\x80", p2.BAD_RANGE),
        (11, b"\x06", 0),
    ],
)
def test_refuses_what_the_table_does_not_take(address: int, data: bytes, error: int) -> None:
    one = servo()
    before = bytes(one.table)
    found = one.write(address, data)
    assert (found != 0) if data == b"\x06" else (found == error)
    assert bytes(one.table) == before


def test_a_model_without_current_has_no_current_mode() -> None:
    assert servo("XL430-W250").write(11, b"\5") == p2.BAD_RANGE
    assert servo("XL430-W250").write(11, b"\4") == 0


def test_an_expired_watchdog_holds_and_takes_no_goals_until_it_is_cleared() -> None:
    one = servo()
    one.write(64, b"\1")
    one.write(98, b"\3")
    one.watch(0.059)
    assert one.get(r.BUS_WATCHDOG) == 3
    one.measure(0.5, 0.0, 0.0, 0.0)
    one.watch(0.061)
    assert one.get(r.BUS_WATCHDOG) == -1
    assert one.get(r.GOAL_POSITION) == one.get(r.PRESENT_POSITION) == 2048 + 326
    assert one.write(116, bytes(4)) == p2.BAD_RANGE
    assert one.write(80, bytes(6)) == 0  # gains, and so damping, it still takes
    assert one.write(98, b"\0") == 0
    assert one.write(116, bytes(4)) == 0


def test_a_shutdown_takes_the_torque_until_a_restart() -> None:
    one = servo()
    one.write(64, b"\1")
    one.warm(79.0)
    assert one.alert == 0
    one.warm(81.0)
    assert one.alert == p2.ALERT
    assert one.get(r.HARDWARE_ERROR) == 4
    assert one.write(64, b"\1") == p2.RESULT_FAIL
    one.power_up(2048)
    assert one.alert == 0
    assert one.write(64, b"\1") == 0


def test_torque_follows_the_law_at_the_joint() -> None:
    one, robot = servo(gear=2.0, direction=-1), Recorder()
    one.power_up(2048)
    one.write(11, b"\5")
    one.write(64, b"\1")
    one.write(80, (1600).to_bytes(2, "little") + bytes(2) + (800).to_bytes(2, "little"))
    one.write(102, (417).to_bytes(2, "little"))
    one.write(116, (2048 - 652).to_bytes(4, "little"))
    one.drive(robot, 3)
    joint, q_rad, dq_rad_s, kp, kd, tau_nm, limit_nm = robot.last
    assert (joint, dq_rad_s, tau_nm) == (3, 0.0, 0.0)
    assert q_rad == pytest.approx(0.5, abs=1e-3)  # -(-652 counts) / 2
    assert kp == pytest.approx(4 * 19.537, rel=1e-4)
    assert kd == pytest.approx(4 * 0.3126, rel=1e-3)
    assert limit_nm == pytest.approx(2 * 2.0, rel=1e-3)


def test_ten_thousand_random_writes_leave_a_legal_table() -> None:
    rng = np.random.default_rng(0)
    one = servo()
    one.write(98, b"\3")
    for _ in range(10_000):
        size = int(rng.integers(1, 12))
        one.write(int(rng.integers(0, 160)), rng.bytes(size))
        assert len(one.table) == r.TABLE_BYTES
    assert one.get(r.MODEL_NUMBER) == 1020
    assert one.get(r.POSITION_P) <= 16383
    assert abs(one.get(r.GOAL_CURRENT)) <= 1193
    assert abs(one.get(r.GOAL_POSITION)) <= r.GOAL_MAX
