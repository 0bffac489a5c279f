"""What the robot of an emulator stands in: from the program that starts it to the physics."""

import pytest

from hal.emulator import cli
from hal.emulator.launch import launch_emulator
from hal.emulator.robot import EmulatedRobot
from tests.hal.emulator.rig import G1, FakeTime
from world.scene import FLAT, Box, Scene

TABLE = Scene(0.1, (Box((0.0, 0.0, 0.2), (0.5, 0.5, 0.3), 0.25),))  # its top at 0.5 m


class Begun(Exception):
    """The emulator would run now."""


@pytest.mark.parametrize(("scene", "ground_m"), [(Scene(0.4), 0.4), (TABLE, 0.5)])
def test_the_robot_hangs_with_its_feet_on_the_ground_of_its_scene(scene, ground_m):
    flat, raised = (EmulatedRobot(G1, scene=of, now=FakeTime()) for of in (FLAT, scene))
    assert raised.truth().root_pos_w[2] - flat.truth().root_pos_w[2] == pytest.approx(ground_m, abs=1e-9)


def test_let_go_it_stays_above_the_table():
    """Slack it sinks together: on the floor its pelvis would be far below the top of the table."""
    clock = FakeTime()
    robot = EmulatedRobot(G1, scene=Scene(0.0, (Box((0.0, 0.0, 0.25), (2.0, 2.0, 0.25)),)), now=clock)
    robot.start()
    robot.release_gantry()
    clock.now_s += 3.0
    assert robot.truth().root_pos_w[2] > 0.5
    robot.stop()


@pytest.mark.parametrize("scene", [FLAT, TABLE])
def test_the_scene_reaches_the_process(monkeypatch, scene):
    commands, built = [], []

    def begin(*arguments, **named):
        built.append(named["scene"])
        raise Begun

    monkeypatch.setattr("hal.emulator.launch.start_emulator", commands.append)
    monkeypatch.setattr(cli, "Emulation", begin)
    launch_emulator("can", scene=scene)
    with pytest.raises(Begun):
        cli.main(commands[0][commands[0].index("can") :])
    assert built == [scene]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{floor", "--scene: not JSON, got {floor, expected such as"),
        ('{"flor_m": 0.4}', "flor_m"),
        ('{"boxes": [{"centre_m": [0, 0, 0], "half_size_m": [0, 1, 1]}]}', "--scene.boxes[0]"),
    ],
)
def test_a_scene_that_is_none_is_refused(capsys, text, words):
    assert cli.main(["can", "--scene", text]) == cli.BAD_INPUT
    assert words in capsys.readouterr().err
