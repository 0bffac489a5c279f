"""The commands motion/check, motion/list and motion/view."""

import re

import av
import numpy as np
import pytest

from motion.cli import check, listing, view
from motion.clip import save_clip
from motion.library import bundled_names
from tests.robot.toy import TOY_YAML

ON_TOY = ("--robot", str(TOY_YAML))  # whose few joints are soon drawn


@pytest.fixture(autouse=True)
def small_pictures_in_an_empty_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("KATA_RENDERER", "software")
    monkeypatch.setattr("motion.report.film.SIZE_PX", 160)
    monkeypatch.chdir(tmp_path)


def test_the_worst_clip_decides(standing_clip, capsys):
    high = np.tile([0.0, 0.0, 1.8], (61, 1))
    save_clip(standing_clip(61, root_pos_w=high), "high.npz")
    assert check.main(["side_kick"]) == 0
    told = capsys.readouterr().out
    assert re.search(r"^side_kick  trackable  ", told, flags=re.MULTILINE)
    assert re.search(r"residual torque Nm +residual force N +residual at s\n.* 0\.0 +0\.0 +0\.0$", told, re.MULTILINE)
    assert check.main(["side_kick", "high.npz"]) == 1
    told = capsys.readouterr().out
    assert re.search(r"^high.npz   not trackable  ", told, flags=re.MULTILINE)
    assert re.search(r"^high.npz: floating", told, flags=re.MULTILINE)
    assert check.main(["nobody", "high.npz"]) == 2
    streams = capsys.readouterr()
    assert "no such clip" in streams.err and "high.npz" in streams.out


def test_a_foreign_clip_that_slides_is_warned_of_and_not_refused(standing_clip, capsys):
    way = np.stack([np.linspace(0.0, 0.15, 61), np.zeros(61), np.full(61, 0.79)], axis=1)
    save_clip(standing_clip(61, root_pos_w=way), "slides.npz")
    assert check.main(["slides.npz"]) == 0
    told = capsys.readouterr().out
    assert re.search(r"^slides.npz: warning: a standing foot slides 150.0 mm \(at most 20\)$", told, re.MULTILINE)


def test_a_clip_that_is_too_short_is_named_by_its_file(standing_clip, capsys):
    save_clip(standing_clip(2, fps=1000.0, source="what its source says"), "short.npz")
    assert check.main(["short.npz"]) == 2
    assert capsys.readouterr().err.startswith("error: short.npz: bad length, got 0.001 s")


def test_collisions_are_told_by_pair(standing_clip, robot, capsys):
    joints = np.tile(robot.default_pos_rad, (31, 1))
    joints[:, robot.joint_names.index("left_shoulder_roll_joint")] = -1.0  # the arm in the body
    save_clip(standing_clip(joint_pos_rad=joints), "arm.npz")
    check.main(["arm.npz"])
    assert re.search(r"^arm.npz: \w+ \+ \w+ inside each other in 31 frames$", capsys.readouterr().out, re.MULTILINE)


def test_clips_that_there_are(standing_clip, tmp_path, capsys):
    (tmp_path / "motions" / "mine").mkdir(parents=True)
    save_clip(standing_clip(31, source="somewhere", license="CC0"), tmp_path / "motions" / "mine" / "mine.npz")
    assert listing.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == [*bundled_names(), "motions/mine/mine.npz"]
    assert lines[-1].split() == ["motions/mine/mine.npz", "1.0", "30", "23", "CC0", "somewhere"]
    (tmp_path / "motions" / "bad.npz").write_bytes(b"no clip")
    assert listing.main([]) == 2
    told = capsys.readouterr()
    assert "motions/bad.npz" in told.err and "motions/mine/mine.npz" in told.out


def test_a_clip_as_a_video(toy_clip, tmp_path, capsys):
    save_clip(toy_clip(4, fps=10.0), tmp_path / "still.npz")
    assert view.main(["still.npz", *ON_TOY]) == 0
    with av.open(str(tmp_path / "still.mp4")) as video:
        assert len(list(video.decode(video=0))) == 4
    assert view.main(["still.npz", "--video", "other.mp4", *ON_TOY]) == 0
    assert (tmp_path / "other.mp4").is_file()
    assert capsys.readouterr().out == "video: still.mp4\nvideo: other.mp4\n"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["taichi", "--video", "a.avi"], "expected .mp4"),
        (["taichi", "--video", "no/a.mp4"], "no such folder"),
        (["nobody"], "no such clip"),
        (["taichi", "--fps", "-1"], "finite number"),
        (["taichi", "--video", "folder.mp4"], "--video folder.mp4: is a folder"),
    ],
)
def test_what_cannot_be_viewed(options, message, capsys, tmp_path):
    (tmp_path / "folder.mp4").mkdir()
    assert view.main(options) == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["folder.mp4"]


def test_the_page_of_a_clip_holds_the_video_and_the_plots(toy_clip, tmp_path, monkeypatch):
    save_clip(toy_clip(3, fps=10.0, source="<here>"), tmp_path / "still.npz")
    served = []
    monkeypatch.setattr("motion.cli.view.serve", lambda page: served.append(page.decode()))
    assert view.main(["still.npz", "--web", *ON_TOY]) == 0
    (text,) = served
    assert text.count("data:image/png;base64,") == 3 and text.count("data:video/mp4;base64,") == 1
    assert "&lt;here&gt;" in text
    assert [path.name for path in tmp_path.iterdir()] == ["still.npz"]
