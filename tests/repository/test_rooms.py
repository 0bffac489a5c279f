"""The repository keeps its own rules: rooms, sizes, names."""

import ast
import os
import re
import stat
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("core", "robot", "world", "view", "motion", "policy", "hal", "deploy", "sim2sim", "train")
RUN_BY_PEOPLE = (
    "deploy/run", "deploy/replay", "deploy/doctor", "sim2sim/evaluate", "train/run.py", "train/report/build",
    "motion/author/build", "motion/process", "motion/view", "motion/check", "motion/list",
)  # fmt: skip
CODE = sorted(
    path for folder in (*ROOMS, "benchmarks", "tests") for path in (ROOT / folder).rglob("*.py") if path.is_file()
)


def table_of_rooms() -> dict[str, set[str]]:
    """The table in CONTRIBUTING.md: room -> rooms that it may import."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    allowed = {}
    for room, cell in re.findall(r"^\| `(\w+)/` \|[^|]*\|([^|]*)\|$", text, flags=re.MULTILINE):
        named = set(re.findall(r"`(\w+)`", cell))
        allowed[room] = set(ROOMS) - named - {room} if "all but" in cell else named
    return {room: allowed[room] for room in ROOMS}


def commands() -> list[Path]:
    """Files of the rooms that a person is meant to run."""
    files = [path for room in ROOMS for path in (ROOT / room).rglob("*") if path.is_file()]
    return sorted(path for path in files if path.stat().st_mode & stat.S_IXUSR and "__pycache__" not in path.parts)


def test_import_rules_say_what_the_table_of_rooms_says() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    forbidden = {
        c["source_modules"][0]: set(c["forbidden_modules"]) for c in contracts if len(c["source_modules"]) == 1
    }
    assert forbidden == {room: set(ROOMS) - allowed - {room} for room, allowed in table_of_rooms().items()}


def test_torch_is_forbidden_outside_training() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (contract,) = [c for c in contracts if "torch" in c["forbidden_modules"]]
    assert set(contract["source_modules"]) == set(ROOMS) - {"train"}


def test_every_folder_of_code_is_a_package_that_the_import_rules_can_see() -> None:
    folders = {path.parent for path in CODE if path.parts[len(ROOT.parts)] in ROOMS}
    assert [str(folder.relative_to(ROOT)) for folder in folders if not (folder / "__init__.py").is_file()] == []


def test_what_takes_part_in_an_emulated_run_goes_by_robot_time() -> None:
    """The machine's own time stays with what says when it is, wakes a person, or waits for a process."""
    of_the_machine = {"hal/emulator/keyboard.py", "hal/emulator/socketcand.py", "hal/wire/backend.py"}
    rooms = [ROOT / "hal" / name for name in ("wire", "can", "dds", "dynamixel", "imu", "emulator")]
    found = {
        str(path.relative_to(ROOT))
        for room in rooms
        for path in room.rglob("*.py")
        if re.search(
            r"^import time$|^from time import (?!monotonic_ns)", path.read_text(encoding="utf-8"), re.MULTILINE
        )
    }
    assert found <= of_the_machine


def test_no_folder_for_odds_and_ends() -> None:
    names = {part for path in CODE for part in path.relative_to(ROOT).with_suffix("").parts}
    assert names.isdisjoint({"utils", "util", "common", "helpers", "misc"})


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """Every statement below `node`, and what holds some; no expressions, which are most of a tree."""
    for field in ("body", "orelse", "finalbody", "handlers", "cases"):
        for below in getattr(node, field, ()):
            yield below
            yield from statements(below)


def test_files_and_functions_stay_small() -> None:
    """Product code; tests and benchmarks, which list cases, may be longer. A codec is one file per maker's protocol."""
    large = []
    for path in CODE:
        room, text = path.relative_to(ROOT).parts[0], path.read_text(encoding="utf-8")
        most_lines, most_of_a_function = (300, 40) if room in ROOMS else (400, 60)
        if text.count("\n") > most_lines and "codecs" not in path.parts:
            large.append(f"{path.relative_to(ROOT)}: {text.count(chr(10))} lines")
        for node in statements(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.end_lineno - node.lineno + 1 > most_of_a_function:
                large.append(f"{path.relative_to(ROOT)}: {node.name} is {node.end_lineno - node.lineno + 1} lines")
    assert large == []


@pytest.mark.parametrize(
    "pattern", [r"['\"]/(work|tmp|root|home)/", r"\bTODO\b", r"\bFIXME\b", r"except:\s", r"raise NotImplementedError"]
)
def test_code_is_free_of(pattern: str) -> None:
    rooms = [path for path in CODE if path.relative_to(ROOT).parts[0] != "tests"]
    found = [str(path.relative_to(ROOT)) for path in rooms if re.search(pattern, path.read_text("utf-8"))]
    assert found == []


def test_commands_start_python_without_their_own_folder_on_the_path() -> None:
    found = commands()
    assert {"deploy/run", "sim2sim/evaluate", "train/run.py"} <= {str(path.relative_to(ROOT)) for path in found}
    for path in found:
        assert path.read_text().startswith("#!/usr/bin/env -S python3 -P\n"), path


@pytest.mark.parametrize("name", RUN_BY_PEOPLE)
def test_a_command_outside_the_environment_says_what_to_do(name: str) -> None:
    # -S leaves out site-packages: a Python in which kata is not installed.
    result = subprocess.run([sys.executable, "-S", "-P", name], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1 and "make install" in result.stderr


@pytest.mark.parametrize("name", [name for name in RUN_BY_PEOPLE if name != "deploy/doctor"])  # loads nothing large
def test_ctrl_c_while_modules_load_ends_at_once(name: str, tmp_path: Path) -> None:
    interrupted = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(60)\n"
    (tmp_path / "mujoco.py").write_text(interrupted)
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-P", name]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    runs_until_told = name in ("deploy/run", "train/run.py")
    assert (result.returncode, result.stdout) == (0 if runs_until_told else 130, "")
    assert result.stderr == "stopped before anything began\n"


def test_make_lists_its_targets() -> None:
    result = subprocess.run(["make"], cwd=ROOT, capture_output=True, text=True, check=True)
    assert re.findall(r"^  make ([\w-]+)", result.stdout, flags=re.MULTILINE) == [
        "help", "install", "demo", "test", "test-wires", "lint", "bench", "train",
    ]  # fmt: skip


def test_licence_is_the_whole_apache_licence() -> None:
    text = (ROOT / "LICENSE").read_text()
    assert "Version 2.0, January 2004" in text and "END OF TERMS AND CONDITIONS" in text
    assert 'license = "Apache-2.0"' in (ROOT / "pyproject.toml").read_text()
