"""Videos, filmstrips, and the live viewer's refusal without a display."""

import io
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import av
import matplotlib.image
import mujoco
import numpy as np
import pytest
from av.codec.codec import UnknownCodecError

from core.errors import InputError
from tests.robot.toy import load_toy
from view.filmstrip import filmstrip, png_bytes
from view.video import VideoWriter
from view.viewer import LiveViewer
from world.model import compile_model


def _pictures(count, height=48, width=64):
    return [np.full((height, width, 3), (20 * i, 100, 255 - 20 * i), dtype=np.uint8) for i in range(count)]


def test_video_plays_what_was_written(tmp_path):
    path = tmp_path / "clip.mp4"
    with VideoWriter(path, 50, (64, 48)) as video:
        for picture in _pictures(10):
            video.add(picture)
        assert not path.exists()
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert stream.average_rate == 50
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 10
    for frame, picture in zip(frames, _pictures(10)):
        assert np.abs(frame.astype(int) - picture).mean() < 6
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_leaves_no_video(tmp_path):
    with pytest.raises(RuntimeError, match="stop"), VideoWriter(tmp_path / "clip.mp4", 30, (64, 48)) as video:
        video.add(_pictures(1)[0])
        raise RuntimeError("stop")
    assert not list(tmp_path.iterdir())


class Container:
    """PyAV's, of a build without libx264, or of one that fails at the video's end."""

    def __init__(self, path, encoder):
        Path(path).write_bytes(b"a beginning")
        self.add_stream, self.mux, self.closed = encoder, lambda packet: None, False

    def close(self):
        self.closed = True


def _no_encoder(name, **options):
    raise UnknownCodecError(name)


def _no_end(name, **options):
    def fail():
        raise OSError("disk full")

    return SimpleNamespace(encode=fail)


def _stub_av(monkeypatch, encoder):
    opened = []
    stub = ModuleType("av")
    stub.FFmpegError = av.FFmpegError
    stub.open = lambda path, **_: opened.append(Container(path, encoder)) or opened[0]
    monkeypatch.setitem(sys.modules, "av", stub)
    return opened


def test_without_an_encoder_the_video_says_what_to_install(tmp_path, monkeypatch):
    opened = _stub_av(monkeypatch, _no_encoder)
    with (
        pytest.raises(InputError, match=r"clip\.mp4: PyAV cannot write it, got libx264; .*pip install"),
        VideoWriter(tmp_path / "clip.mp4", 30, (64, 48)),
    ):
        pass
    assert opened[0].closed and not list(tmp_path.iterdir())


def test_a_video_whose_end_cannot_be_written_is_none(tmp_path, monkeypatch):
    opened = _stub_av(monkeypatch, _no_end)
    (tmp_path / "clip.mp4").write_bytes(b"an older video")
    with pytest.raises(OSError, match="disk full"), VideoWriter(tmp_path / "clip.mp4", 30, (64, 48)):
        pass
    assert opened[0].closed and [path.read_bytes() for path in tmp_path.iterdir()] == [b"an older video"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("clip.mp4", 30, (63, 48)), "picture size, got 63 x 48, expected two even numbers"),
        (("clip.mp4", 0, (64, 48)), "fps, got 0"),
        (("clip.avi", 30, (64, 48)), "unknown kind of file, got .avi, expected .mp4"),
        (("nowhere/clip.mp4", 30, (64, 48)), "no such folder"),
    ],
)
def test_impossible_videos_are_refused_before_any_work(tmp_path, arguments, message):
    name, fps, size = arguments
    with pytest.raises(InputError, match=message):
        VideoWriter(tmp_path / name, fps, size)


def test_a_picture_of_another_size_is_refused(tmp_path):
    with (
        pytest.raises(InputError, match=r"picture, got \(48, 60, 3\) uint8, expected \(48, 64, 3\) uint8"),
        VideoWriter(tmp_path / "clip.mp4", 30, (64, 48)) as video,
    ):
        video.add(_pictures(1, width=60)[0])


def test_filmstrip_places_pictures_row_by_row():
    pictures = _pictures(5, 10, 20)
    strip = filmstrip(pictures, columns=3)
    assert strip.shape == (22, 64, 3)
    assert (strip[:10, 22:42] == pictures[1]).all() and (strip[12:, :20] == pictures[3]).all()
    assert (strip[12:, 44:] == 255).all()
    read = matplotlib.image.imread(io.BytesIO(png_bytes(strip)), format="png")
    assert np.array_equal(np.round(read * 255).astype(np.uint8), strip)


def test_unusable_strips_are_refused():
    with pytest.raises(InputError, match="got no pictures"):
        filmstrip([])
    with pytest.raises(InputError, match="expected one size"):
        filmstrip([*_pictures(1), *_pictures(1, 50)])
    with pytest.raises(InputError, match=r"picture, got \(48, 64\) uint8"):
        png_bytes(_pictures(1)[0][..., 0])


def test_live_viewer_without_a_display_says_so(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    model = compile_model(load_toy(), timestep_s=0.005)
    with pytest.raises(InputError, match=r"no display for a live window; .*--video"):
        LiveViewer(model, mujoco.MjData(model))
