"""Each rule on arrays whose answer is known by hand."""

from dataclasses import replace

import numpy as np
import pytest

from core.rotations import quat_from_axis_angle, quat_rotate
from motion import plausibility
from motion.plausibility import FilterSettings, outside_support_m, sole_lean_rad
from motion.settings import read_section
from motion.track import SupportTrack

SQUARE = np.array([[-0.1, -0.05, 0.0], [-0.1, 0.05, 0.0], [0.1, -0.05, 0.0], [0.1, 0.05, 0.0]])
_LEFT = np.array([0.0, 0.1, 0.0])
FEET = np.stack([SQUARE + _LEFT, SQUARE - _LEFT])
FPS = 30.0


@pytest.fixture(scope="module")
def settings() -> FilterSettings:
    return read_section(FilterSettings, "filter")


def track(num_frames: int = 91, **changes) -> SupportTrack:
    """Somebody who stands on two flat feet."""
    values = {
        "fps": FPS,
        "com_w": np.tile([0.0, 0.0, 1.0], (num_frames, 1)),
        "root_pos_w": np.tile([0.0, 0.0, 1.0], (num_frames, 1)),
        "root_quat_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (num_frames, 1)),
        "speed": np.ones((num_frames, 2)),
        "speed_limit": np.array([2.0, 5.0]),
        "speed_names": ("hand", "foot"),
        "speed_unit": "m/s",
    }
    sole_w = changes.pop("sole_w", np.tile(FEET, (num_frames, 1, 1, 1)))
    return SupportTrack(**(values | {"sole_w": sole_w, "bearing_w": sole_w.reshape(len(sole_w), -1, 3)} | changes))


def rising(height_m: np.ndarray) -> np.ndarray:
    """Soles at `height_m` (N,)."""
    return FEET + height_m[:, None, None, None] * np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((0.0, 0.0), -0.1),  # the front edge is 0.1 m away, the side 0.15 m
        ((0.0, 0.1), -0.05),
        ((0.3, 0.0), 0.2),
        ((0.13, 0.19), 0.05),  # beyond the corner (0.1, 0.15), by 3 and 4 cm
    ],
)
def test_distance_from_the_hull_of_the_soles(point, expected):
    assert outside_support_m(np.array([point]), FEET.reshape(1, -1, 3))[0] == pytest.approx(expected, abs=2e-4)


def test_raised_soles_do_not_support():
    raised = FEET.copy()
    raised[1, :, 2] = 0.06
    assert outside_support_m(np.array([[0.0, 0.0]]), raised.reshape(1, -1, 3))[0] == pytest.approx(0.05)
    raised[:, :, 2] = 0.06
    assert outside_support_m(np.array([[0.0, 0.0]]), raised.reshape(1, -1, 3))[0] == np.inf


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.35, 1.0])
def test_lean_of_a_turned_sole(angle):
    axis = np.array([0.6, 0.8, 0.0])
    turned = quat_rotate(np.broadcast_to(quat_from_axis_angle(axis, np.array(angle)), (*FEET.shape[:2], 4)), FEET)
    np.testing.assert_allclose(sole_lean_rad(turned[None]), angle, atol=1e-7)


def test_balance_in_a_wide_stance_over_one_foot(settings):
    """Feet 0.6 m apart: over the left one the pressure of level feet is 0.3 m away, but that foot can bear alone."""
    wide = np.tile(FEET + np.array([[[0.0, 0.2, 0.0]], [[0.0, -0.2, 0.0]]]), (91, 1, 1, 1))
    over_left = track(sole_w=wide, com_w=np.tile([0.0, 0.3, 1.0], (91, 1)))
    distance = np.full(91, 0.3)
    assert plausibility.balance(over_left, distance, settings).passed
    strict = plausibility.balance(over_left, distance, replace(settings, support_margin_m=10.0))
    assert not strict.passed and "in the first frame the centre of mass is 0.30 m beside" in strict.reason


@pytest.mark.parametrize(("unstable", "passed"), [(98, True), (99, False)])
def test_balance_counts_the_gap(settings, unstable, passed):
    """The paper's t_k+1 - t_k: 99 unstable frames lie between stable ones 100 apart."""
    com, distance = np.tile([0.0, 0.0, 1.0], (200, 1)), np.zeros(200)
    com[50 : 50 + unstable, 0], distance[50 : 50 + unstable] = 0.5, 0.5
    finding = plausibility.balance(track(200, com_w=com), distance, settings)
    assert finding.passed is passed
    np.testing.assert_array_equal(finding.frames, np.arange(50, 50 + unstable))
    assert (finding.value, finding.limit) == (unstable + 1, 100)
    assert passed or "from 1.7 s it is 100 frames (at 30 fps) to a stable one" in finding.reason


def test_balance_names_the_last_frame(settings):
    com, distance = np.tile([0.0, 0.0, 1.0], (91, 1)), np.zeros(91)
    com[-1, 0], distance[-1] = 3.0, np.inf
    finding = plausibility.balance(track(com_w=com), distance, settings)
    assert "in the last frame the centre of mass is above nothing that touches the ground" in finding.reason


@pytest.mark.parametrize(("seconds", "passed"), [(0.7, True), (0.9, False)])
def test_flight_no_longer_than_a_jump(settings, seconds, passed):
    height = np.zeros(91)
    height[30 : 30 + round(seconds * FPS)] = 0.2
    finding = plausibility.flight(track(sole_w=rising(height)), settings)
    assert finding.passed is passed and finding.value == pytest.approx(seconds)
    assert passed or finding.reason.startswith("floating: from 1.0 s nothing is within 5 cm of the ground for 0.9 s")


def test_sinking(settings):
    height = np.zeros(91)
    height[60] = -0.2
    finding = plausibility.sinking(track(sole_w=rising(height)), settings)
    assert not finding.passed and finding.frames.tolist() == [60]
    assert finding.reason == "sunk: at 2.0 s a sole is 0.20 m below the ground (at most 0.15)"


def test_tilt_looks_at_the_flattest_feet_at_rest(settings):
    """A foot that leans half of the time is no tilted world; one that always does, is."""
    leaning = quat_rotate(
        np.broadcast_to(quat_from_axis_angle(np.array([0.0, 1.0, 0.0]), np.array(0.35)), (4, 4)), FEET
    )
    soles = np.tile(FEET, (91, 1, 1, 1))
    soles[:50] = leaning
    assert plausibility.tilt(track(sole_w=soles), settings).passed
    finding = plausibility.tilt(track(sole_w=np.tile(leaning, (91, 1, 1, 1))), settings)
    assert not finding.passed and finding.value == pytest.approx(0.35) and "lean by 20 degrees" in finding.reason


def test_jump_and_spin(settings):
    pos, quat = np.tile([0.0, 0.0, 1.0], (91, 1)), np.tile([1.0, 0.0, 0.0, 0.0], (91, 1))
    pos[45:, 1] += 0.2
    quat[60:] = [0.0, 0.0, 0.0, 1.0]
    leap = plausibility.jump(track(root_pos_w=pos), settings)
    assert not leap.passed and leap.value == pytest.approx(180.0) and "leaps: at 1.5 s" in leap.reason
    turn = plausibility.spin(track(root_quat_wxyz=quat), settings)
    assert not turn.passed and turn.value > 30.0 and "turns over: at 2.0 s" in turn.reason


def test_speed_names_the_fastest(settings):
    speed = np.ones((91, 2))
    speed[30, 1] = 6.0
    finding = plausibility.speed(track(speed=speed), settings)
    assert finding.reason == "too fast: at 1.0 s foot moves at 6.0 m/s (at most 5)" and finding.frames.tolist() == [30]
    assert plausibility.speed(track(), settings).reason == ""


def swaying(amplitude_m: float, frequency_hz: float, axis: int) -> np.ndarray:
    com = np.tile([0.0, 0.0, 1.0], (301, 1))
    com[:, axis] += amplitude_m * np.sin(2.0 * np.pi * frequency_hz * np.arange(301) / FPS)
    return com


@pytest.mark.parametrize(
    ("amplitude", "frequency", "axis", "passed"),
    [
        (0.1, 1.0, 0, True),  # 3.9 m/s² sideways
        (0.1, 3.0, 0, False),  # 35 m/s²: friction of 3.6
        (0.05, 1.0, 2, True),
        (0.05, 3.0, 2, False),  # 18 m/s² downwards: the ground would have to pull
    ],
)
def test_force_from_the_acceleration(settings, amplitude, frequency, axis, passed):
    assert plausibility.force(track(301, com_w=swaying(amplitude, frequency, axis)), settings).passed is passed


def test_force_knows_free_fall(settings):
    """Hops that fall at 1.2 g, nearly free: with the feet on the ground the same path would need it to pull."""
    t = np.arange(91) / FPS
    flight = np.maximum(0.0, 2.4 * (t % 0.6) - 0.5 * 1.2 * 9.81 * (t % 0.6) ** 2)
    com = np.tile([0.0, 0.0, 1.0], (91, 1))
    com[:, 2] += flight
    hop = plausibility.force(track(com_w=com, sole_w=rising(flight)), settings)
    glued = plausibility.force(track(com_w=com), settings)
    assert len(hop.frames) < len(glued.frames)
    flying = np.flatnonzero(flight > 0.15)
    assert not set(flying) & set(hop.frames) and set(flying) & set(glued.frames)
