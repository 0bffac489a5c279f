"""Results are written whole or not at all, where they can be."""

import json

import pytest

from deploy.outputs import check_output_file, check_output_folder, replacing, write_json
from robot.errors import InputError


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
