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
        ({"feet": {}}, "feet: missing field"),
        ({"extra": 1}, "unknown field extra"),
        ({"t_pose_rad": {"left_wing": 0.1}}, "t_pose_rad: unknown field left_wing"),
        ({"legs": {"left": ["left_leg", "trunk"], "right": ["right_leg", "right_foot"]}}, "left: ends elsewhere"),
        ({"legs": {"left": ["left_foot"], "right": ["right_leg", "right_foot"]}}, "two or more tracked points"),
        ({"rotations": [{"human": "tail", "body": "trunk", "weight": 1}]}, r"row 0: human: unknown name, got tail"),
        ({"rotations": [{"human": "pelvis", "body": "head", "weight": 1}]}, r"row 0: body: unknown name, got head"),
        ({"rotations": [{"human": "pelvis", "body": "trunk", "weight": -1}]}, "weight: negative"),
        ({"rotations": 3}, "expected a list of rows"),
        ({"segments": [{"human": ["neck"], "robot": ["trunk", "head"], "weight": 1}]}, "human: wrong value"),
        ({"root_position_weight": "much"}, "root_position_weight: not a finite number"),
    ],
)
def test_what_is_wrong_is_named(change, message, toy, tmp_path: Path):
    table = yaml.safe_load(TOY_SETTINGS.read_text()) | change
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(table))
    with pytest.raises(InputError, match=message) as caught:
        load_settings(toy, path)
    assert "mine.yaml" in str(caught.value)


@pytest.mark.parametrize("iterations", [0, 2.5])
def test_a_count_is_a_whole_number(iterations, toy, tmp_path: Path):
    table = yaml.safe_load(TOY_SETTINGS.read_text())
    table["solver"]["iterations"] = iterations
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(table))
    with pytest.raises(InputError, match="solver: iterations: wrong count"):
        load_settings(toy, path)
