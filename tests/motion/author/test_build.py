"""Building: the same clip every time, and one error that names file and key."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from core.errors import InputError
from motion.author.cli import CHOREOGRAPHIES, CLIPS, build_clip, choreography_names, choreography_of, main
from motion.author.stand import stand_pose
from motion.author.targets import body_targets
from motion.clip import Clip, load_clip
from robot.robot import Robot
from world.model import compile_model

SHORT = """
fps: 25
keys:
  - {at_s: 0.0}
  - {at_s: 0.6, hold: all}
  - at_s: 1.6
    pose: arms up
KEY
  - {at_s: 2.6, stand: all}
  - {at_s: 3.4, stand: all}
"""


def written(folder: Path, key: str) -> Path:
    path = folder / "short.yaml"
    lines = "\n".join(f"    {line}" for line in key.splitlines())
    path.write_text(SHORT.replace("KEY", lines))
    return path


def test_rebuilding_gives_the_bundled_clip(robot: Robot):
    built, bundled = build_clip(CHOREOGRAPHIES / "side_kick.yaml", robot), load_clip(CLIPS / "side_kick.npz")
    assert built.num_frames == bundled.num_frames
    for name in ("root_pos_w", "root_quat_wxyz", "joint_pos_rad"):
        np.testing.assert_allclose(getattr(built, name), getattr(bundled, name), atol=1e-6)
    np.testing.assert_array_equal(built.contact, bundled.contact)


def test_every_choreography_asks_for_the_contacts_of_the_bundled_clip(robot: Robot):
    stand = stand_pose(robot)
    for name in choreography_names():
        targets = body_targets(choreography_of(CHOREOGRAPHIES / f"{name}.yaml", stand), stand)
        np.testing.assert_array_equal(targets.contact, load_clip(CLIPS / f"{name}.npz").contact)


@pytest.fixture(scope="module")
def reaching(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("reaching"), "arms: {hand_m: [0.3, 0.2, 0.1], swivel_rad: 0.4}")


@pytest.fixture(scope="module")
def reached(robot: Robot, reaching: Path) -> Clip:
    return build_clip(reaching, robot)


def test_hand_goes_where_the_key_says(robot: Robot, reached: Clip):
    frame = 40  # at 1.6 s
    model = compile_model(robot, timestep_s=0.02)
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate(
        [reached.root_pos_w[frame], reached.root_quat_wxyz[frame], reached.joint_pos_rad[frame]]
    )
    mujoco.mj_kinematics(model, data)
    torso = data.body("torso_link")
    for side, y in (("left", 0.2), ("right", -0.2)):
        elbow = data.body(f"{side}_elbow_link")
        hand = elbow.xpos + elbow.xmat.reshape(3, 3) @ [0.25, 0.0, 0.0]
        np.testing.assert_allclose(torso.xmat.reshape(3, 3).T @ (hand - torso.xpos), [0.3, y, 0.1], atol=1e-3)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("head: {yaw_rad: 0.1}", ["keys[2]", "keys[2].head: unknown key", "left_foot"]),
        ("pelvis: {height_m: 0.1}", ["keys[2]", "pelvis", "pelvis.height_m: unknown key", "sink_m"]),
        ("pelvis: {sink_m: low}", ["keys[2]", "sink_m", "low", "a number"]),
        ("pelvis: 3", ["keys[2]", "pelvis", "got 3", "table"]),
        ("hold: [tail]", ["keys[2]", "hold", "tail", "left_arm"]),
        ("arms: {hand_m: [0.3, 0.2]}", ["keys[2]", "hand_m", "[x, y, z]"]),
        ("arms: {hand_m: [0.3, 0.2, 0.1]}\nleft_arm: {swivel_rad: 0.1}", ["keys[2]", "set twice"]),
        ("arms: {hand_m: [0.9, 0.2, 0.1]}", ["hand: unreachable target", "keys[2]", "arms up", "off at"]),
        ("pelvis: {sink_m: 0.6}", ["unreachable target", "keys[2]", "off at"]),
        ("left_foot: {x_m: 0.2}", ["keys[2]", "left_foot", "would slide", "arc_m"]),
        ("left_foot: {z_m: -0.1}", ["keys[2]", "left_foot", "below the ground"]),
        ("left_foot: {z_m: 0.1}", ["keys[2]", "left foot is in the air and bears weight", "balance.left"]),
        ("left_foot: {roll_rad: 0.1, arc_m: 0.05}", ["keys[2]", "sole not flat"]),
    ],
)
def test_a_wrong_key_is_one_error_naming_it(robot: Robot, tmp_path: Path, key: str, words: list[str]):
    path = written(tmp_path, key)
    with pytest.raises(InputError) as error:
        build_clip(path, robot)
    message = str(error.value)
    assert "\n" not in message
    for word in [str(path), *words]:
        assert word in message


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fps: 50", ["keys: missing key"]),
        ("fps: 0\nkeys: [{at_s: 0}, {at_s: 1}]", ["fps", "out of range"]),
        ("fps: 50\nspeed: 2\nkeys: [{at_s: 0}, {at_s: 1}]", ["speed: unknown key"]),
        ("fps: 50\nkeys: []", ["keys", "two or more"]),
        ("fps: 50\nkeys: [{at_s: 0}, {pose: x}]", ["keys[1]", "keys[1].at_s: missing key"]),
        ("fps: 50\nkeys: [{at_s: 1}, {at_s: 2}]", ["keys[0].at_s", "got 1.0", "expected 0"]),
        ("fps: 50\nkeys: [{at_s: 0}, {at_s: 2}, {at_s: 2}]", ["keys[2].at_s", "do not increase"]),
        ("fps: 50\nkeys: [{at_s: 0}, {at_s: .nan}]", ["keys[1].at_s", "a finite number"]),
        ("fps: 50\nkeys: [{at_s: 0}, {at_s: 1.013}]", ["keys[1].at_s", "whole number of frames"]),
        ("fps: 50\nkeys: [{at_s: 0}, {at_s: 1, pelvis: {sink_m: 0.05}}]", ["does not end in the stand pose", "pelvis"]),
        ("keys: [", ["not a readable YAML file"]),
        ("- 1", ["got a list"]),
    ],
)
def test_a_wrong_file_is_one_error_naming_it(robot: Robot, tmp_path: Path, text: str, words: list[str]):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        build_clip(path, robot)
    for word in [str(path), *words]:
        assert word in str(error.value)


def test_command_writes_the_named_clip_with_the_same_bits(
    reaching: Path, reached: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    monkeypatch.setattr("motion.author.cli.CHOREOGRAPHIES", reaching.parent)
    assert main([reaching.stem, "--out", str(tmp_path / "new" / "clips")]) == 0
    built = load_clip(tmp_path / "new" / "clips" / "short.npz")
    assert built.duration_s == 3.4 and built.sha256 == reached.sha256
    assert capsys.readouterr().out.startswith("short: 3.4 s")


@pytest.mark.parametrize(
    "arguments",
    [["nothing"], ["stand", "nothing"], ["../motion/stand"], ["--what"], ["stand", "--out", "/dev/null/clips"]],
)
def test_command_ends_with_2_and_one_line(arguments: list[str], capsys: pytest.CaptureFixture):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1
    assert captured.out == ""
