"""Errors in the settings name the file, the field and what to do."""

from pathlib import Path

import pytest
import yaml

from core.errors import InputError
from motion.retarget.settings import SETTINGS, load_settings
from tests.motion.retarget.conftest import TOY_SETTINGS


def test_a_robot_without_settings_is_told_what_to_write(toy):
    with pytest.raises(InputError, match=r"toy\.yaml: no retargeting settings for robot toy.*write .*g1_23dof\.yaml"):
        load_settings(toy)


def test_every_bundled_robot_has_settings():
    robots = {path.name for path in (SETTINGS.parents[1] / "robot").glob("*.yaml")}
    assert {path.name for path in SETTINGS.glob("*.yaml")} == robots


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"feet": {}}, "feet: missing keys contact_position_weight, .*held_turn_rad, got nothing"),
        ({"extra": 1}, "extra: unknown key, expected one of rotations"),
        ({"t_pose_rad": {"left_wing": 0.1}}, r"t_pose_rad\.left_wing: unknown key, expected one of left_hip"),
        (
            {"legs": {"left": ["left_leg", "trunk"], "right": ["right_leg", "right_foot"]}},
            r"legs\.left: ends elsewhere, got trunk, expected the foot, left_foot",
        ),
        (
            {"legs": {"left": ["left_foot"], "right": ["right_leg", "right_foot"]}},
            r"legs\.left: too few, got .*left_foot.*, expected two or more tracked points",
        ),
        (
            {"rotations": [{"human": "tail", "body": "trunk", "weight": 1}]},
            r"rotations\[0 tail\]\.human: unknown joint, got tail, expected one of pelvis",
        ),
        (
            {"rotations": [{"human": "pelvis", "body": "head", "weight": 1}]},
            r"rotations\[0 pelvis\]\.body: unknown body, got head, expected one of trunk",
        ),
        (
            {"rotations": [{"human": "pelvis", "body": "trunk", "weight": -1}]},
            r"rotations\[0 pelvis\]\.weight: too small, got -1\.0, expected at least 0",
        ),
        ({"rotations": 3}, "rotations: wrong type, got 3, expected a list"),
        (
            {"segments": [{"human": ["neck"], "robot": ["trunk", "head"], "weight": 1}]},
            r"segments\[0\]\.human: wrong length, got .*neck.*, expected a list of 2",
        ),
        ({"root_position_weight": "much"}, "root_position_weight: wrong type, got 'much', expected a number"),
    ],
)
def test_what_is_wrong_is_named(change, message, toy, tmp_path: Path):
    table = yaml.safe_load(TOY_SETTINGS.read_text()) | change
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(table))
    with pytest.raises(InputError, match=message) as caught:
        load_settings(toy, path)
    assert "mine.yaml" in str(caught.value)


@pytest.mark.parametrize(
    ("iterations", "message"),
    [(0, "too small, got 0, expected at least 1"), (2.5, r"wrong type, got 2\.5, expected a whole number")],
)
def test_a_count_is_a_whole_number(iterations, message, toy, tmp_path: Path):
    table = yaml.safe_load(TOY_SETTINGS.read_text())
    table["solver"]["iterations"] = iterations
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(table))
    with pytest.raises(InputError, match=rf"mine\.yaml: solver\.iterations: {message}"):
        load_settings(toy, path)
