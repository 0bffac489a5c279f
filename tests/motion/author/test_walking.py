"""Walks: where feet land, by hand; and a built one, by MuJoCo's kinematics and the rules of the filter."""

import math

import numpy as np
import pytest

from core.errors import InputError
from motion.author.cli import build_clip
from motion.author.walking import Part, Walk, walk_keys
from motion.filter import judge
from motion.reference import build_reference
from motion.residual_wrench import demand_of, residual_wrench
from robot.robot import Robot

FEET = {"left": (0.0, 0.1), "right": (0.0, -0.1)}
HANDS = {"left": (0.1, 0.2, -0.1), "right": (0.1, -0.2, -0.1)}
AT_ONCE = (10.0, 10.0, 10.0)


def landings(walk: Walk) -> list[tuple[str, dict]]:
    """Side and place of each step's foot."""
    keys = walk_keys(walk, FEET, HANDS)
    return [(side, key[f"{side}_foot"]) for key in keys for side in FEET if f"{side}_foot" in key]


def test_feet_land_half_a_step_ahead_of_the_walker_and_come_together():
    """0.5 m/s in steps of 0.4 s: 0.2 m a step. After one step the walker is at 0.2 m, and the foot at 0.3 m."""
    steps = landings(Walk((Part(1.2, forward_m_s=0.5),), step_s=0.4, ramp=AT_ONCE))
    assert [side for side, _ in steps] == ["left", "right"] * 3
    assert [place["x_m"] for _, place in steps] == pytest.approx([0.3, 0.5, 0.6, 0.6, 0.6, 0.6])
    assert [place["y_m"] for _, place in steps] == pytest.approx([0.0] * 6)


def test_a_turn_takes_feet_around_the_walker():
    steps = landings(Walk((Part(0.8, turn_rad_s=1.0),), step_s=0.4, ramp=AT_ONCE))
    angle = 0.8
    side, place = steps[-1]
    beside = FEET[side][1]
    assert place["yaw_rad"] == pytest.approx(angle)
    assert place["x_m"] == pytest.approx(-beside * math.sin(angle))
    assert place["y_m"] == pytest.approx(beside * math.cos(angle) - beside)


def test_speeds_rise_and_fall_by_the_ramp():
    steps = landings(Walk((Part(0.8, forward_m_s=0.4),), step_s=0.4, ramp=(0.2, 0.1, 0.4)))
    # Speeds 0.2, 0.4, 0.2, 0, 0, 0 of the steps: places of the walker 0.08, 0.24, 0.32, and on the spot.
    assert [place["x_m"] for _, place in steps] == pytest.approx([0.16, 0.28, 0.32, 0.32, 0.32, 0.32])


def test_to_the_right_the_right_foot_goes_first():
    (side, place), *_ = landings(Walk((Part(0.8, left_m_s=-0.2),), ramp=AT_ONCE))
    assert side == "right" and place["y_m"] < 0.0


@pytest.fixture(scope="module")
def built(robot: Robot, tmp_path_factory: pytest.TempPathFactory):
    path = tmp_path_factory.mktemp("walk") / "short.yaml"
    parts = "[{for_s: 1.2, forward_m_s: 0.4, turn_rad_s: 0.5}, {for_s: 0.4}, {for_s: 0.8, left_m_s: -0.2}]"
    path.write_text(f"fps: 40\nwalk:\n  parts: {parts}\n")
    return build_clip(path, robot)


def test_a_built_walk_can_be_performed(built, robot):
    verdict = judge((built, robot))
    assert verdict.stable, verdict.reasons
    left = residual_wrench(demand_of(robot, build_reference(built, robot)))
    assert left.torque_nm.max() < 2.0 and left.force_n.max() < 2.0


def test_a_built_walk_goes_where_it_says_and_stands_still_with_what_bears(built, robot):
    # Ramped by 0.4 rad/s: 0.4, 0.5, 0.5 and 0.1 rad/s of steps of 0.4 s.
    heading = 2.0 * np.arctan2(built.root_quat_wxyz[-1, 3], built.root_quat_wxyz[-1, 0])
    assert heading == pytest.approx(0.4 * (0.4 + 2 * 0.5 + 0.1), abs=0.02)
    feet = robot.tracked_index(robot.feet)
    reference = build_reference(built, robot)
    soles = reference.body_pos_w[:, feet]
    moving = np.linalg.norm(np.diff(soles, axis=0), axis=-1) * 40.0
    down = (reference.contact[1:] > 0.5) & (reference.contact[:-1] > 0.5)
    assert moving[down].max() < 0.05 and moving[~down].max() > 0.5
    assert (reference.contact.max(axis=1) > 0.5).all()  # never in the air


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("parts: []", "walk.parts"),
        ("parts: [{for_s: 0}]", "for_s"),
        ("parts: [{for_s: 1, forward_m_s: 9}]", "forward_m_s"),
        ("parts: [{for_s: 1, sideways: 1}]", "sideways"),
        ("{parts: [{for_s: 1}], step_s: 0.2}", "double_s"),
    ],
)
def test_walks_that_cannot_be_are_refused_by_name(text, said, robot, tmp_path):
    path = tmp_path / "bad.yaml"
    path.write_text(f"fps: 50\nwalk: {{{text}}}\n" if text.startswith("parts") else f"fps: 50\nwalk: {text}\n")
    with pytest.raises(InputError, match=said):
        build_clip(path, robot)


def test_a_file_has_keys_or_a_walk(robot, tmp_path):
    (tmp_path / "both.yaml").write_text("fps: 50\nkeys: []\nwalk: {parts: [{for_s: 1}]}\n")
    with pytest.raises(InputError, match="keys: unknown key"):
        build_clip(tmp_path / "both.yaml", robot)
