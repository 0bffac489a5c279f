"""Results are written whole or not at all, where they can be."""

import json
import os

import pytest

from core.errors import InputError
from core.files import check_output_file, check_output_folder, check_output_kind, replacing, write_json, write_whole


def test_missing_parents_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"--json .*no such folder"):
        check_output_file("--json", tmp_path / "none" / "a.json")
    with pytest.raises(InputError, match=r"--log .*no such folder"):
        check_output_folder("--log", tmp_path / "none" / "logs")
    check_output_file("--json", tmp_path / "a.json")
    check_output_folder("--log", tmp_path / "logs")
    check_output_file("--json", None)
    check_output_folder("--log", None)


def test_wrong_kinds_are_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a folder"):
        check_output_file("--video", tmp_path)
    with pytest.raises(InputError, match="is a file"):
        check_output_folder("--log", tmp_path / "file")


def test_json_replaces_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"a": 1.5, "b": None})
    assert json.loads(path.read_text()) == {"a": 1.5, "b": None}
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(path, {"a": float("nan")})
    with pytest.raises(RuntimeError), replacing(path) as unfinished:
        unfinished.write_text("half")
        raise RuntimeError
    assert json.loads(path.read_text()) == {"a": 1.5, "b": None}
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.json"]


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_whole(path, b"old")
    path.chmod(0o640)

    def fail(_):
        raise OSError("disk full")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        with pytest.raises(OSError, match="disk full"):
            write_whole(path, b"new and longer")
    assert path.read_bytes() == b"old" and [entry.name for entry in tmp_path.iterdir()] == ["file"]
    write_whole(path, b"new and longer")
    assert path.read_bytes() == b"new and longer" and path.stat().st_mode & 0o777 == 0o640


def test_kinds_of_files_are_told_by_their_ending(tmp_path):
    check_output_kind(tmp_path / "a.MP4", (".mp4",))
    with pytest.raises(InputError, match=r"a\.avi: unknown kind of file, got \.avi, expected \.mp4"):
        check_output_kind(tmp_path / "a.avi", (".mp4",))
    with pytest.raises(InputError, match="no such folder"):
        check_output_kind(tmp_path / "none" / "a.mp4", (".mp4",))
