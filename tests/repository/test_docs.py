"""What the documents tell people to type works: commands, options, names and files that they mention exist."""

import os
import re
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from deploy.operator.keys import KEYS
from train.config import check as check_configuration
from train.config import compose_document

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LONGEST_SENTENCE_WORDS, LONGEST_CELL = 25, 250


def code_lines(path: Path) -> list[str]:
    """Lines of the shell blocks, without comments and blanks."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    lines = [re.sub(r"(^|\s)#.*$", "", line).strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line]


def text_of(path: Path) -> str:
    """Without blocks of code and comments; a piece of code or a link is one word or its words."""
    text = re.sub(r"^ *```.*?^ *```$|<!--.*?-->", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "code", text))


def sentences(path: Path) -> list[str]:
    """Of paragraphs and of items of lists, not of headings, tables and indented lines."""
    blocks = [""]
    for line in text_of(path).splitlines():
        if not line.strip() or line.startswith(("#", "|", "    ")):
            blocks.append("")
        elif item := re.match(r"\s*(?:[-*]|\d+\.) (.*)", line):
            blocks.append(item.group(1))
        else:
            blocks[-1] += f" {line.strip()}"
    return [sentence for block in blocks for sentence in re.split(r"(?<=[.!?])\W*\s+", block)]


# By command: whoever tests a row of them asks each for its help once.
COMMANDS = sorted(((path.name, line) for path in DOCUMENTS for line in code_lines(path)), key=lambda one: one[1])
CLIPS = {path.stem for path in (ROOT / "motion" / "clips").glob("*.npz")}
ACTORS = {path.parent.name for path in (ROOT / "policy" / "actors").glob("*/actor.onnx")}


@cache
def help_of(command: str) -> str:
    assert not command.startswith("."), (
        f"{command}: only commands of the rooms are shown; .ci/run would call these tests"
    )
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    result = subprocess.run(
        [f"./{command}", "--help"], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, f"{command} --help: {result.stderr}"
    return result.stdout


def check_options(command: str, words: list[str]) -> None:
    """Flags are in the command's help, and so are the words given to flags that offer a choice."""
    text = help_of(command)
    for flag, value in zip(words, [*words[1:], ""]):
        if flag.startswith("--"):
            assert re.search(rf"{flag}(?![\w-])", text), f"{command} has no {flag}"
            choices = re.search(rf"{flag} \{{([\w,-]+)\}}", text)
            assert choices is None or value in choices.group(1).split(","), f"{command} {flag} {value}"
        if flag == "--policy":
            check_name(value, ACTORS, (".onnx",))


def check_name(value: str, bundled: set[str], suffixes: tuple[str, ...]) -> None:
    """A bundled name, or a file that the reader is to have."""
    assert value in bundled or Path(value).suffix in suffixes, f"{value} is neither bundled nor a file"


def check_overrides(words: list[str]) -> None:
    """What train/run.py would compose and check; files that the reader is to have need not be there."""
    if any(word.startswith("resume=") for word in words):
        return
    document = compose_document([word for word in words if word != "--print"])
    check_configuration(document)
    if document["motions"] is None:
        check_name(document["motion"], CLIPS, (".npz", ".pkl", ".csv"))


def test_the_documents_have_commands() -> None:
    assert {"make demo", "make install"} <= {line for name, line in COMMANDS if name == "README.md"}
    for command in ("train/run.py", "deploy/run", "sim2sim/evaluate"):
        assert any(line.startswith(command) for _, line in COMMANDS)


@pytest.mark.parametrize(("document", "line"), COMMANDS, ids=lambda value: value)
def test_command_works_as_written(document: str, line: str) -> None:
    words = shlex.split(line)
    command = words[0]
    if command == "make":
        targets = re.findall(r"^(\w+):.*## ", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
        assert set(words[1:]) <= set(targets)
    elif line == ". .venv/bin/activate":
        pass
    else:
        path = ROOT / command
        assert path.is_file() and os.access(path, os.X_OK), f"{document}: no executable {command}"
        if command == "train/run.py":
            check_overrides(words[1:])
        else:
            check_options(command, words[1:])


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_and_paths_lead_somewhere(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    targets = [link for link in re.findall(r"\]\(([^)#\s]+)\)", text) if "://" not in link]
    missing = [link for link in targets if not (path.parent / link).exists()]
    rooms = "core|robot|world|view|motion|policy|hal|deploy|sim2sim|train|configs|tests|benchmarks|docs"
    named = re.findall(rf"`((?:{rooms})/[\w./]*)`", text)
    missing += [name for name in named if "NAME" not in name and not (ROOT / name).exists()]
    assert missing == []


def test_sentences_and_cells_are_what_is_counted(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# Not this\n\nOne `a b c` two. **Three** [four five](six)!\n- seven\n\n| eight |\n```sh\nnine\n```\n"
    )
    assert [re.findall(r"\w+", sentence) for sentence in sentences(page) if sentence] == [
        ["One", "code", "two"],
        ["Three", "four", "five"],
        ["seven"],
    ]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_sentences_and_cells_are_short(path: Path) -> None:
    counted = [sum(1 for word in sentence.split() if re.search(r"\w", word)) for sentence in sentences(path)]
    long = [text for text, words in zip(sentences(path), counted) if words > LONGEST_SENTENCE_WORDS]
    rows = re.findall(r"^\|(.*)\|$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    long += [cell for row in rows for cell in re.split(r"(?<!\\)\|", row) if len(cell.strip()) > LONGEST_CELL]
    assert long == []


def test_table_of_keys_is_what_the_operator_understands() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = {}
    for key, space, does in re.findall(r"^\| `(\w)`( or space)? \| (.*?) \|$", text, flags=re.MULTILINE):
        told |= dict.fromkeys([key, " "] if space else [key], does)
    assert told.keys() == KEYS.keys()
    for key, request in KEYS.items():
        word = {"switch": "next", "start": "start"}.get(request.value, request.value)
        assert word in told[key], f"{key!r} is {request.value}, the table says {told[key]}"
