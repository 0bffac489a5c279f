"""Files that people write: where they are found, what is read from them, and the exact words about what is not."""

import json
import math
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from core.config import CONFIGS, config_file, errors_in, load_options, read_json, read_yaml
from core.errors import InputError
from core.structured import at_least


@dataclass(frozen=True)
class Stage:
    """Two numbers, as a file may hold them."""

    step_s: float
    count: int = 3

    def __post_init__(self) -> None:
        at_least("count", self.count, 1)


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "mine.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_name_is_a_bundled_file_and_a_path_is_itself(tmp_path: Path) -> None:
    assert config_file("deploy", "default") == CONFIGS / "deploy" / "default.yaml"
    own = written(tmp_path, "a: 1")
    assert config_file("deploy", own) == own and config_file("deploy", str(own)) == own


def test_a_file_that_is_not_there_is_named() -> None:
    with pytest.raises(InputError) as caught:
        config_file("deploy", "nowhere.yaml")
    assert str(caught.value) == "nowhere.yaml: no such file"
    with pytest.raises(InputError) as caught:
        config_file("deploy", "defalt")
    text = "unknown deploy configuration, got defalt, expected one of default, or a .yaml file; did you mean default?"
    assert str(caught.value) == text
    with pytest.raises(InputError, match=r"^gone\.yaml: no such file$"):
        read_yaml(Path("gone.yaml"))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("step_s: 2e-3", Stage(0.002)),
        ("step_s: 1\ncount: 4", Stage(1.0, 4)),
        ("count: &same 5\nstep_s: *same", Stage(5.0, 5)),
    ],
)
def test_a_file_becomes_a_dataclass(tmp_path: Path, text: str, expected: Stage) -> None:
    assert load_options(Stage, written(tmp_path, text)) == expected


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "step_s: missing key, got nothing"),
        ("step_s: 1\nstep: 2", "step: unknown key, expected one of step_s, count; did you mean step_s?"),
        ("step_s: soon", "step_s: wrong type, got 'soon', expected a number in s"),
        ("step_s: 1\ncount: 0", "count: too small, got 0, expected at least 1"),
        ("- 1", "wrong type, got a list, expected a mapping"),
        ("3", "wrong type, got a int, expected a mapping"),
    ],
)
def test_errors_begin_with_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_options(Stage, path)
    assert str(caught.value) == f"{path}: {message}"


@pytest.mark.parametrize(
    "content",
    [
        b"step_s: [",
        b"\xff\xfe\x00",
        b"step_s: 1\nstep_s: 2",
        b"!!python/object/apply:os.getcwd []",
        b"step_s: 1\ninner: {a: 1, a: 2}",
        b"[" * 5000,
        b"step_s: " + b"9" * 5000,
    ],
)
def test_what_is_no_yaml_is_one_line(tmp_path: Path, content: bytes) -> None:
    path = written(tmp_path, content)
    with pytest.raises(InputError) as caught:
        load_options(Stage, path)
    assert str(caught.value).startswith(f"{path}: not a readable YAML file, got ")
    assert "\n" not in str(caught.value)


def test_a_folder_in_the_place_of_a_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"not a readable YAML file, got .*directory"):
        read_yaml(tmp_path)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("1e-3", 0.001), ("-1.", -1.0), (".5E+2", 50.0), ("7", 7), ("-.inf", -math.inf)),
        *((text, text) for text in ("1e", ".", "1.2.3", "2026-11-28", "${now:%Y}", "???")),
        ("'1e3'", "1e3"),
    ],
)
def test_fractions_are_those_of_yaml_1_2_and_the_rest_is_text(tmp_path: Path, text: str, value: object) -> None:
    (read,) = read_yaml(written(tmp_path, f"a: {text}")).values()
    assert read == value and type(read) is type(value)


def test_json_is_read_exactly() -> None:
    document = {"kp": [0.1, 1e-300, 5], "name": "ü", "none": None}
    assert read_json(json.dumps(document), "actor_spec") == document


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"kp": NaN}', "not a finite number, got NaN, expected finite numbers only"),
        ('{"kp": -Infinity}', "not a finite number, got -Infinity, expected finite numbers only"),
        ('{"a": 1, "b": {"kp": 1, "kp": 2}}', "key given twice, got kp, expected each key once"),
    ],
)
def test_json_that_says_nothing_sure_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_json(text, "actor_spec")
    assert str(caught.value) == f"actor_spec: {message}"


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, "9" * 5000, '{"a" 1}'])
def test_malformed_json_is_one_line(text: str) -> None:
    with pytest.raises(InputError, match=r"^actor_spec: malformed JSON \(") as caught:
        read_json(text, "actor_spec")
    assert "\n" not in str(caught.value)


def test_errors_about_a_files_content_name_it() -> None:
    with pytest.raises(InputError, match=r"^a\.yaml: joints: no joints$"), errors_in(Path("a.yaml")):
        raise InputError("no joints", where="joints")
    with pytest.raises(ZeroDivisionError), errors_in(Path("a.yaml")):
        math.sqrt(1 // 0)


def test_the_ground_floor_is_light() -> None:
    """Neither the simulator nor torch nor a YAML reader is imported before a file is read."""
    code = "import core.config, sys; print(*({'mujoco', 'torch', 'omegaconf', 'yaml'} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""
