"""Motor side and joint side: worked out by hand, and there and back again."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from hal.contract.joint_map import JointMap
from hal.contract.types import DeviceFault
from world.actuation import JointCommand

# Motor 1 turns with its joint through 2:1; motor 2 against it, one to one, its zero at 0.5.
TWO = JointMap.of(["a", "b"], [1, -1], [0.0, 0.5], [2.0, 1.0])


def random_map(rng: np.random.Generator, count: int = 8) -> JointMap:
    mapped = JointMap.of(
        [f"j{i}" for i in range(count)],
        rng.choice([-1.0, 1.0], count),
        rng.uniform(-6.0, 6.0, count),
        rng.uniform(0.2, 20.0, count),
    )
    return replace(mapped, turns=rng.integers(-2, 3, count).astype(float))


def random_command(rng: np.random.Generator, count: int) -> JointCommand:
    kp, kd = rng.uniform(0, 400, count), rng.uniform(0, 5, count)
    return JointCommand(rng.normal(size=count), rng.normal(size=count), kp, kd, rng.normal(size=count))


def test_by_hand() -> None:
    np.testing.assert_allclose(TWO.pos_rad(np.array([1.0, 0.2])), [0.5, 0.3])
    np.testing.assert_allclose(TWO.vel_rad_s(np.array([4.0, 1.0])), [2.0, -1.0])
    np.testing.assert_allclose(TWO.torque_nm(np.array([3.0, 3.0])), [6.0, -3.0])
    raw = TWO.raw_command(
        JointCommand(*(np.array(x) for x in ([0.1, 0.3], [1.0, 1.0], [80.0, 40.0], [4.0, 2.0], [6.0, 5.0]))),
        np.array([0, 1]),
    )
    np.testing.assert_allclose(raw.q_rad, [0.2, 0.2])
    np.testing.assert_allclose(raw.dq_rad_s, [2.0, -1.0])
    np.testing.assert_allclose(raw.kp, [20.0, 40.0])
    np.testing.assert_allclose(raw.kd, [1.0, 2.0])
    np.testing.assert_allclose(raw.tau_nm, [3.0, -5.0])


@pytest.mark.parametrize("seed", range(20))
def test_there_and_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mapped = random_map(rng)
    values = rng.normal(size=8)
    np.testing.assert_allclose(mapped.pos_rad(mapped.raw_rad(values)), values, atol=1e-9)
    np.testing.assert_allclose(mapped.vel_rad_s(mapped.raw_rad_s(values)), values)
    np.testing.assert_allclose(mapped.torque_nm(mapped.raw_nm(values)), values)
    np.testing.assert_allclose(mapped.gain(mapped.raw_gain(values)), values)
    command = random_command(rng, 8)
    raw = mapped.raw_command(command, np.arange(8))
    back = JointCommand(
        mapped.pos_rad(raw.q_rad),
        mapped.vel_rad_s(raw.dq_rad_s),
        mapped.gain(raw.kp),
        mapped.gain(raw.kd),
        mapped.torque_nm(raw.tau_nm),
    )
    for name in ("q_rad", "dq_rad_s", "kp", "kd", "tau_nm"):
        np.testing.assert_allclose(getattr(back, name), getattr(command, name), atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_same_torque_on_both_sides(seed: int) -> None:
    """The motor's law on what it measures, carried to the joint, is the joint's law; power is the same."""
    rng = np.random.default_rng(seed)
    mapped, command = random_map(rng), random_command(rng, 8)
    raw_pos, raw_vel = rng.normal(size=8), rng.normal(size=8)
    raw = mapped.raw_command(command, np.arange(8))
    motor_nm = raw.kp * (raw.q_rad - raw_pos) + raw.kd * (raw.dq_rad_s - raw_vel) + raw.tau_nm
    pos, vel = mapped.pos_rad(raw_pos), mapped.vel_rad_s(raw_vel)
    joint_nm = command.kp * (command.q_rad - pos) + command.kd * (command.dq_rad_s - vel) + command.tau_nm
    np.testing.assert_allclose(mapped.torque_nm(motor_nm), joint_nm, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(motor_nm * raw_vel, joint_nm * vel, rtol=1e-6, atol=1e-6)


def test_by_name_whatever_the_order() -> None:
    """Motors in one order, the robot's joints in another."""
    command = JointCommand(*(np.array(x, dtype=float) for x in ([1, 2, 3], [0] * 3, [1] * 3, [1] * 3, [0] * 3)))
    mapped = JointMap.of(["c", "a"], [1, 1], [0, 0], [1, 1])
    np.testing.assert_array_equal(mapped.raw_command(command, np.array([2, 0])).q_rad, [3.0, 1.0])
    assert mapped.take([1]).joint_names == ("a",)


@pytest.mark.parametrize("seed", range(10))
def test_folding_finds_the_turns_that_were_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mapped = random_map(rng)
    half = 0.45 * mapped.turn_rad
    middle = rng.uniform(-1.0, 1.0, 8)
    lower, upper = middle - half, middle + half
    true = rng.uniform(lower, upper)
    raw = mapped.raw_rad(true) + 2.0 * math.pi * rng.integers(-3, 4, 8)
    np.testing.assert_allclose(mapped.folded(raw, lower, upper).pos_rad(raw), true, atol=1e-9)


def test_what_fits_nowhere_is_refused_by_name() -> None:
    lower, upper = np.array([-0.5, -0.5]), np.array([0.5, 0.5])
    with pytest.raises(DeviceFault, match=r"b: at .* rad, outside -0.500 to 0.500 rad"):
        TWO.folded(np.array([0.0, 3.0]), lower, upper)


def test_a_motor_that_counts_its_turns_is_not_folded() -> None:
    lower, upper = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    raw = np.array([0.1 + 2.0 * math.pi, 0.5])
    assert TWO.folded(raw, lower, upper).turns.tolist() == [-1.0, 0.0]
    with pytest.raises(DeviceFault, match=r"a: at 3\.192 rad"):
        TWO.folded(raw, lower, upper, np.array([False, False]))


def test_a_lost_count_is_told_from_a_joint_that_moved() -> None:
    lower, upper = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    assert TWO.slipped(np.array([0.3, 1.2]), lower, upper).tolist() == [False, False]
    assert TWO.slipped(np.array([0.3 + math.pi, 0.3 - 2 * math.pi]), lower, upper).tolist() == [True, True]
    assert TWO.slipped(np.array([np.nan, np.inf]), lower, upper).tolist() == [False, False]


def test_a_band_wider_than_a_turn_is_ambiguous() -> None:
    lower, upper = np.array([-2.0, -2.0]), np.array([2.0, 2.0])
    TWO.check_bands(lower, upper, np.array([False, True]))
    with pytest.raises(InputError, match="a: the joint's band holds more than one turn"):
        TWO.check_bands(lower, upper, np.array([True, True]))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((["a", "a"], [1, 1], [0, 0], [1, 1]), "more than one motor, got a"),
        ((["a"], [0], [0], [1]), "a: direction, got 0.0"),
        ((["a"], [1], [math.nan], [1]), "a: zero_rad"),
        ((["a"], [1], [0], [0]), "a: gear"),
    ],
)
def test_impossible_figures(arguments: tuple, message: str) -> None:
    with pytest.raises(InputError, match=message):
        JointMap.of(*arguments)
