"""Finding a motion by name or file, whatever its ending."""

import pickle

import numpy as np
import pytest

from core.errors import InputError
from motion import library
from motion.clip import Clip, load_clip, save_clip
from motion.library import bundled_names, open_motion
from tests.shared_data import SHARED, needs_shared_data


def test_every_bundled_clip_opens_and_is_the_robots(robot):
    assert "stand" in bundled_names()
    for name in bundled_names():
        clip = open_motion(name, robot)
        assert set(clip.joint_names) == set(robot.joint_names)
        assert clip.license == "Apache-2.0"


def test_a_file_is_known_by_its_content(robot, standing_clip, tmp_path):
    clip = standing_clip()
    save_clip(clip, tmp_path / "a.npz")
    for ending in ("npz", "pkl", "csv", "bin"):
        path = tmp_path / f"b.{ending}"
        path.write_bytes((tmp_path / "a.npz").read_bytes())
        assert open_motion(path, robot).sha256 == clip.sha256


@needs_shared_data
def test_real_files_open(robot, tmp_path):
    pkl, csv = SHARED / "pbhc" / "Horse-stance_pose.pkl", SHARED / "g1moves" / "M_Move19.csv"
    assert open_motion(pkl, robot).num_frames == 210
    assert open_motion(csv, robot).fps == 60.0
    assert open_motion(str(csv), robot, csv_fps=30.0).fps == 30.0
    for source in (pkl, csv):
        copy = tmp_path / "without_ending"
        copy.write_bytes(source.read_bytes())
        assert open_motion(copy, robot).num_frames == open_motion(source, robot).num_frames


@needs_shared_data
def test_imported_clips_can_be_saved_and_opened_again(robot, tmp_path):
    clip = open_motion(SHARED / "pbhc" / "Roundhouse_kick.pkl", robot)
    save_clip(clip, tmp_path / "kick.npz")
    assert load_clip(tmp_path / "kick.npz").sha256 == clip.sha256


def test_unknown_name_lists_the_bundled_ones(robot):
    with pytest.raises(InputError, match=r"moonwalk: no such clip, expected one of .*stand"):
        open_motion("moonwalk", robot)


@pytest.mark.parametrize("name", ["moonwalk.npz", "some/where/moonwalk", "../stand", "a.pkl"])
def test_missing_file(robot, name):
    with pytest.raises(InputError, match="no such file"):
        open_motion(name, robot)


@pytest.mark.parametrize("name", ["", "a\0b"])
def test_no_name(robot, name):
    with pytest.raises(InputError, match="no motion given"):
        open_motion(name, robot)


CONTENTS = {
    "x.npz": b"",
    "y.npz": b"text",
    "x.pkl": b"text",
    "y.pkl": b"",
    "x.csv": b"",
    "y.csv": b"1,2\n",
    "noise": b"\0\1",
}


@pytest.mark.parametrize(("name", "content"), CONTENTS.items())
def test_damaged_files_are_one_error_with_the_path(robot, tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        open_motion(tmp_path / name, robot)
    assert str(caught.value).startswith(str(tmp_path / name)) and "\n" not in str(caught.value)
    assert str(caught.value).count(name) == 1


def test_folder_and_unreadable(robot, tmp_path):
    with pytest.raises(InputError, match="is no file"):
        open_motion(tmp_path, robot)
    (tmp_path / "loop.npz").symlink_to(tmp_path / "loop.npz")
    with pytest.raises(InputError, match=r"loop\.npz"):
        open_motion(tmp_path / "loop.npz", robot)


def test_joints_of_another_robot(robot, fields, tmp_path):
    save_clip(Clip(**fields), tmp_path / "a.npz")
    with pytest.raises(InputError, match=r"a\.npz: .*unknown hip, knee, missing left_hip_pitch_joint"):
        open_motion(tmp_path / "a.npz", robot)


def test_malicious_pickle_under_any_name(robot, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    class Evil:
        def __reduce__(self):
            return (open, ("executed", "w"))

    for name in ("a.pkl", "a.npz", "a.csv", "a"):
        (tmp_path / name).write_bytes(pickle.dumps({"k": Evil()}))
        with pytest.raises(InputError, match=r"global '_?io\.open'"):
            open_motion(tmp_path / name, robot)
    np.savez(tmp_path / "b.npz", fps=np.array([Evil()], dtype=object))
    with pytest.raises(InputError, match="fps: type not allowed"):
        open_motion(tmp_path / "b.npz", robot)
    assert not (tmp_path / "executed").exists()


def test_no_bundled_clips_is_said(robot, tmp_path, monkeypatch):
    monkeypatch.setattr(library, "CLIPS", tmp_path)
    assert bundled_names() == ()
    with pytest.raises(InputError, match="no such clip"):
        open_motion("stand", robot)
