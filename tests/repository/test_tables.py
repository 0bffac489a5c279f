"""BENCHMARKS.md says what benchmarks/results says."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.scores import measured
from benchmarks.tables import PAGE, RESULTS, cell, render, renew
from core.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
SCORES = {"episodes": 24, "survival_rate": 0.875, "metrics": {"empbpe_mm": {"mean": 6.25, "std": 0.94}}}
DOCUMENT: dict[str, Any] = {
    "commands": ["sim2sim/evaluate --policy taichi"],
    "columns": [
        {"head": "actor", "path": "actor"},
        {"head": "falls", "path": "scores", "show": "falls"},
        {"head": "Empbpe mm", "path": "scores.metrics.empbpe_mm", "digits": 1},
        {"head": "samples", "path": "samples"},
    ],
    "rows": [
        {"actor": "taichi", "scores": SCORES, "samples": 18745344},
        {"actor": "a", "scores": SCORES, "samples": None},
    ],
}
RENDERED = """```sh
sim2sim/evaluate --policy taichi
```

| actor | falls | Empbpe mm | samples |
|---|---|---|---|
| taichi | 3 of 24 | 6.2 ± 0.9 | 18,745,344 |
| a | 3 of 24 | 6.2 ± 0.9 |  |
"""
MARKED = "# Page\n\n<!-- table one -->\nstale\n<!-- end -->\n\nKept.\n"


def test_page_and_results_agree() -> None:
    command = [sys.executable, "-P", "benchmarks/tables.py", "--check"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_a_changed_figure_is_a_disagreement(tmp_path: Path) -> None:
    for path in RESULTS.glob("*.json"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    page = PAGE.read_text(encoding="utf-8")
    assert renew(page, tmp_path) == page
    changed = json.loads((tmp_path / "can_soak_counts.json").read_text())
    changed["rows"][0]["count"] = 1
    (tmp_path / "can_soak_counts.json").write_text(json.dumps(changed))
    assert renew(page, tmp_path) != page


def test_a_table_with_its_command() -> None:
    assert render(DOCUMENT) == RENDERED


def test_commands_of_another_commit_are_not_those_of_today() -> None:
    text = render({**DOCUMENT, "commit": "eaa9f05"})
    assert text.startswith("```text\n# at commit eaa9f05\nsim2sim/evaluate --policy taichi\n```\n")


@pytest.mark.parametrize(
    ("value", "digits", "show", "expected"),
    [
        (SCORES, None, "survivors", "21 of 24"),
        (SCORES, None, "falls", "3 of 24"),
        ({"mean": 100.0, "std": 2.5}, 2, None, "100.00 ± 2.50"),
        (0.1915, 2, None, "0.19"),
        ("1.5 to 2", 1, None, "1.5 to 2"),
        (None, 1, None, ""),
    ],
)
def test_cells(value: Any, digits: int | None, show: str | None, expected: str) -> None:
    assert cell(value, digits, show) == expected


def test_only_what_is_marked_changes(tmp_path: Path) -> None:
    (tmp_path / "one.json").write_text(json.dumps(DOCUMENT), encoding="utf-8")
    assert renew(MARKED, tmp_path) == f"# Page\n\n<!-- table one -->\n{RENDERED}<!-- end -->\n\nKept.\n"


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "one.json.*FileNotFoundError"),
        ("{", "one.json.*JSONDecodeError"),
        (json.dumps({"commands": [], "columns": []}), "one.json.*rows"),
        (json.dumps({**DOCUMENT, "rows": [{"actor": "taichi"}]}), "one.json.*no 'scores'"),
        (json.dumps({**DOCUMENT, "columns": [{"head": "", "path": "actor", "show": "all"}]}), "one.json.*show 'all'"),
        (json.dumps({**DOCUMENT, "columns": [{"head": "", "path": "scores.metrics"}]}), "one.json.*mean"),
    ],
)
def test_an_unfit_file_is_named(content: str | None, expected: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "one.json").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=expected):
        renew(MARKED, tmp_path)


def test_a_file_that_no_table_shows_is_named(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / f"{name}.json").write_text(json.dumps(DOCUMENT), encoding="utf-8")
    with pytest.raises(ValueError, match=r"no table of the page is made from two\.json"):
        renew(MARKED, tmp_path)


def told(survival_rate: float, error_mm: float) -> dict[str, Any]:
    """As a run of sim2sim/evaluate --json."""
    identity = {"policy_sha256": "5", "motion": "m", "sim": "default", "episodes": 24, "seed": 3}
    metrics = {name: {"mean": error_mm, "std": 1.23456, "worst": 9.0} for name in ("empbpe_mm", "empjpe_mrad")}
    return {**identity, "survival_rate": survival_rate, "metrics": metrics}


def test_scores_are_measured_anew_by_the_commands_of_the_table() -> None:
    columns = [{"head": "survive", "path": "scores", "show": "survivors"}, DOCUMENT["columns"][2]]
    rows = [{"actor": a, "condition": c, "note": a + c, "scores": SCORES} for a in "ab" for c in ("calm", "wild")]
    commands = ["sim2sim/evaluate --policy a --policy b", "sim2sim/evaluate --policy a --policy b --randomize"]
    document = {"commands": commands, "columns": columns, "rows": rows}
    answers = {
        commands[0]: {"runs": [told(1.0, 1.0), told(0.5, 2.0)]},
        commands[1]: {"runs": [told(0.0, 3.0), told(1.0, 4.0)]},
    }
    new = measured(document, answers.__getitem__)
    assert [(row["note"], row["scores"]["survival_rate"]) for row in new["rows"]] == [
        ("acalm", 1.0), ("awild", 0.0), ("bcalm", 0.5), ("bwild", 1.0)
    ]  # fmt: skip
    assert [row["scores"]["metrics"] for row in new["rows"]] == [
        {"empbpe_mm": {"mean": mean, "std": 1.2346}} for mean in (1.0, 3.0, 2.0, 4.0)
    ]
    alone = {**document, "commands": commands[:1], "rows": rows[:1]}
    assert measured(alone, lambda command: told(1.0, 7.0))["rows"][0]["scores"]["metrics"]["empbpe_mm"]["mean"] == 7.0
    with pytest.raises(InputError, match="another number of runs"):
        measured(alone, answers.__getitem__)
    with pytest.raises(InputError, match="no table of scores"):
        measured({**document, "commands": commands[:1]}, answers.__getitem__)
