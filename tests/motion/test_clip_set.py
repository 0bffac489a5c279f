"""Clip sets: folders and manifests, and what is wrong with some."""

import hashlib
from pathlib import Path

import pytest

from core.errors import InputError
from motion.clip import save_clip
from motion.clip_set import open_clip_set, open_clips
from robot.robot import load_robot
from tests.train.worlds import g1, swaying_clip

ROBOT = g1()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, seconds in (("long", 1.0), ("brief", 0.4)):
        save_clip(swaying_clip(ROBOT, seconds), tmp_path / f"{name}.npz")
    (tmp_path / "notes.txt").write_text("no clip")
    return tmp_path


def manifest(folder: Path, text: str) -> Path:
    path = folder / "set.yaml"
    path.write_text(text)
    return path


def test_a_folder_is_all_its_clips_by_name(folder):
    found = open_clip_set(folder, ROBOT)
    assert [(one.name, round(one.clip.duration_s, 3)) for one in found] == [("brief", 0.4), ("long", 1.0)]


def test_endings_in_capitals_count_and_hidden_files_do_not(folder):
    (folder / "long.npz").rename(folder / "LONG.NPZ")
    (folder / "._brief.npz").write_bytes(b"what macOS leaves")
    assert [one.name for one in open_clip_set(folder, ROBOT)] == ["LONG", "brief"]


def test_a_bundled_name_is_the_clip_whatever_lies_in_the_working_directory(folder, monkeypatch):
    (folder / "taichi").mkdir()
    (folder / "brief.npz").rename(folder / "taichi" / "brief.npz")
    monkeypatch.chdir(folder)
    assert [one.name for one in open_clips(["taichi", "./taichi"], load_robot())] == ["taichi", "brief"]


def test_a_manifest_names_clips_of_each_split(folder):
    digest = hashlib.sha256((folder / "long.npz").read_bytes()).hexdigest()
    path = manifest(
        folder,
        f"clips:\n- {{file: long.npz, sha256: {digest}, licence: CC0, labels: [sway, slow]}}\n"
        "- {file: brief.npz, split: test}\n",
    )
    (train,), (test,) = open_clip_set(path, ROBOT), open_clip_set(path, ROBOT, "test")
    assert (train.name, train.clip.license, test.name) == ("long", "CC0", "brief")


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("clips: []\n", "set.yaml: clips: no clip"),
        ("clips: [{file: long.npz, split: test}]\n", "set.yaml: no clip, expected one or more of split train"),
        ("clips: [{file: long.npz, licens: CC0}]\n", r"clips\[0 long.npz\].licens: unknown key.*did you mean licence"),
        ("clips: [{file: long.npz, split: dev}]\n", r"clips\[0 long.npz\].split: unknown choice"),
        (
            "clips: [{file: long.npz, sha256: 00ff}]\n",
            r"clips\[long\].sha256: another file, got [0-9a-f]{64}",
        ),
        ("clips: [{file: none.npz}]\n", "none.npz"),
        ("clips: [{file: long.npz}, {file: b/long.csv}]\n", "clips: two clips of the same name, got long"),
    ],
)
def test_a_manifest_that_is_wrong_is_told_by_file_and_field(folder, text, wrong):
    with pytest.raises(InputError, match=wrong):
        open_clip_set(manifest(folder, text), ROBOT)


def test_what_is_no_set_is_refused(folder, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty: no clip"):
        open_clip_set(tmp_path / "empty", ROBOT)
    with pytest.raises(InputError, match="no such clip set"):
        open_clip_set(tmp_path / "long.npz", ROBOT)
    (tmp_path / "long.csv").write_text("")
    with pytest.raises(InputError, match="two clips of the same name, got long"):
        open_clip_set(folder, ROBOT)
