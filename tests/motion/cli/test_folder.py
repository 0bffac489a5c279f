"""Results appear whole, and take the place of results only."""

import json
from pathlib import Path

import pytest

from core.errors import InputError
from motion.cli.folder import check_folder, write_folder
from motion.report.record import CREATED_BY

REPORT = json.dumps({"created_by": CREATED_BY}).encode()
FILES = {"walk.npz": b"clip", "report.html": b"page", "report.json": REPORT}


def held(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_new_folder_an_empty_one_and_an_own_one_are_taken(tmp_path):
    folder = tmp_path / "walk"
    write_folder(folder, FILES)
    assert held(folder) == FILES
    write_folder(folder, {"report.json": REPORT})  # this time no clip could be made
    assert held(folder) == {"report.json": REPORT}
    (tmp_path / "empty").mkdir()
    write_folder(tmp_path / "empty", FILES)
    assert held(tmp_path / "empty") == FILES
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "walk"]


@pytest.mark.parametrize(
    "files",
    [
        {"notes.txt": b"mine"},
        FILES | {"notes.txt": b"mine"},
        FILES | {"other.npz": b"mine"},
        FILES | {"report.json": b"{"},
        FILES | {"report.json": b"[1]"},
        FILES | {"report.json": b'{"created_by": "somebody"}'},
        {"walk.npz": b"mine"},
    ],
)
def test_anybody_elses_folder_stays_as_it_is(tmp_path, files):
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=r"folder is in use.*expected a new or empty folder, or one that"):
        write_folder(tmp_path, FILES)
    assert held(tmp_path) == files


def test_a_file_or_a_missing_parent_is_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.raises(InputError, match="is a file"):
        check_folder(tmp_path / "file")
    with pytest.raises(InputError, match="no such folder"):
        check_folder(tmp_path / "a" / "b")
    with pytest.raises(InputError, match="no such folder"):
        check_folder(tmp_path / "a" / "b" / "c", makes_parent=True)
    write_folder(tmp_path / "a" / "b", FILES, makes_parent=True)
    assert held(tmp_path / "a" / "b") == FILES


def test_neither_the_working_directory_nor_a_mount_point_is_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in (tmp_path, Path()):
        with pytest.raises(InputError, match="cannot be replaced, got the working directory; name a folder in it"):
            check_folder(folder)
    monkeypatch.setattr(Path, "is_mount", lambda path: path.name == "disk")
    (tmp_path / "disk").mkdir()
    with pytest.raises(InputError, match="disk: cannot be replaced, got a mount point; name a folder in it"):
        check_folder(tmp_path / "disk")


def test_what_fails_half_way_leaves_the_old_result(tmp_path):
    folder = tmp_path / "walk"
    write_folder(folder, FILES)
    with pytest.raises(TypeError):
        write_folder(folder, {"walk.npz": b"new", "report.html": "not bytes"})
    assert held(folder) == FILES
    assert list(tmp_path.iterdir()) == [folder]
