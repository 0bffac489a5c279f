"""Frames remembered during a run, drawn afterwards, whole or not at all."""

import numpy as np
import pytest

from core.errors import InputError
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.record.film import Film, ghost_qpos, state_qpos
from deploy.record.recorder import Recorder
from deploy.safety.guard import Guard
from tests.deploy.toys import HEIGHT_M, PERIOD_S, ROBOT, SETTINGS, linear_run, state
from world.model import compile_model

av = pytest.importorskip("av")


@pytest.fixture(autouse=True)
def draw_in_software(monkeypatch):
    """The same everywhere, and quicker than looking for a driver."""
    monkeypatch.setenv("KATA_RENDERER", "software")


def filmed(tmp_path, ticks, name="run.mp4"):
    run = linear_run(tmp_path, seconds=0.4)
    machine = StateMachine(ROBOT, None, [run], SETTINGS, PERIOD_S)
    machine.start_tracking()
    tick, recorder = Tick(machine, Guard(ROBOT, SETTINGS, PERIOD_S)), Recorder()
    film = Film(tmp_path / name, recorder, HEIGHT_M, PERIOD_S)
    for _ in range(ticks):
        result = tick(state())
        recorder(state(), result, None)
        film(state(), result, None)
    return film, recorder, result


def test_every_second_tick_becomes_a_frame(tmp_path):
    film, _, _ = filmed(tmp_path, 6)
    assert film.draw(compile_model(ROBOT, timestep_s=PERIOD_S), lambda: False)
    with av.open(str(tmp_path / "run.mp4")) as video:
        frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert len(frames) == 3 and frames[0].shape == (480, 640, 3) and frames[0].std() > 5


def test_a_png_is_a_strip_of_eight_pictures(tmp_path):
    film, _, _ = filmed(tmp_path, 18, "run.png")
    assert film.draw(compile_model(ROBOT, timestep_s=PERIOD_S), lambda: False)
    with av.open(str(tmp_path / "run.png")) as picture:
        strip = next(picture.decode(video=0)).to_ndarray(format="rgb24")
    assert strip.shape == (2 * 240 + 2, 4 * 220 + 3 * 2, 3) and (strip[240:242] == 255).all()


def test_stopped_leaves_no_file(tmp_path):
    film, _, _ = filmed(tmp_path, 6)
    answers = iter([False, True])
    assert not film.draw(compile_model(ROBOT, timestep_s=PERIOD_S), lambda: next(answers))
    assert {path.suffix for path in tmp_path.iterdir()} <= {".onnx"}


def test_nothing_seen_leaves_no_file(tmp_path):
    film, _, _ = filmed(tmp_path, 1)
    assert not film.draw(compile_model(ROBOT, timestep_s=PERIOD_S), lambda: False)
    assert {path.suffix for path in tmp_path.iterdir()} <= {".onnx"}


def test_the_ghost_is_the_reference_at_this_tick(tmp_path):
    _, recorder, result = filmed(tmp_path, 3)
    ghost = ghost_qpos(recorder, result)
    np.testing.assert_allclose(ghost[7:], ROBOT.default_pos_rad, atol=1e-12)
    np.testing.assert_allclose(state_qpos(state(), HEIGHT_M)[:7], [0, 0, HEIGHT_M, 1, 0, 0, 0])


def test_unusable_video_paths_are_refused_before_the_run(tmp_path):
    with pytest.raises(InputError, match=r"expected \.mp4 or \.png"):
        Film(tmp_path / "run.gif", Recorder(), HEIGHT_M, PERIOD_S)
