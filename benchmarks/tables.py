#!/usr/bin/env -S python3 -P
"""Tables of BENCHMARKS.md, made from what the commands wrote.

`benchmarks/results/NAME.json` holds one table: its `commands`, its `columns` and its `rows`. A row is an object whose
values are words, numbers, or documents of a command's --json, trimmed to what is shown. A column has a `head`, the
`path` of its value in a row (keys joined by dots; null gives an empty cell) and optionally

    digits   after the point, of a number or of `{"mean", "std"}`
    show     survivors or falls: of a document with `survival_rate` and `episodes`

Where a table belongs, the page has `<!-- table NAME -->` and `<!-- end -->`; what stands between them is replaced.
A file with `commit` tells of the code of that commit: its commands are not those of today.
"""

import argparse
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGE, RESULTS = ROOT / "BENCHMARKS.md", ROOT / "benchmarks" / "results"
MARKED = re.compile(r"(<!-- table ([\w-]+) -->\n).*?(<!-- end -->)", flags=re.DOTALL)


def value_at(row: Any, path: str) -> Any:
    """What lies at `path` ("scores.metrics.empbpe_mm") of a row. Raises ValueError where there is no such key."""
    for key in path.split("."):
        if not isinstance(row, Mapping) or key not in row:
            raise ValueError(f"no {key!r} of {path!r} in the row {row}")
        row = row[key]
    return row


def cell(value: Any, digits: int | None = None, show: str | None = None) -> str:
    """One cell. Raises ValueError for a value or a `show` that cannot be shown."""
    if value is None:
        return ""
    if show in ("survivors", "falls"):
        survivors = round(value["survival_rate"] * value["episodes"])
        return f"{survivors if show == 'survivors' else value['episodes'] - survivors} of {value['episodes']}"
    if show is not None:
        raise ValueError(f"show {show!r}: survivors or falls")
    if isinstance(value, Mapping):
        return f"{value['mean']:.{digits or 0}f} ± {value['std']:.{digits or 0}f}"
    if isinstance(value, str):
        return value
    if isinstance(value, int | float):
        return f"{value:,}" if digits is None else f"{value:,.{digits}f}"
    raise ValueError(f"neither text nor a number: {value}")


def render(document: Mapping[str, Any]) -> str:
    """Commands and table of one results file, as Markdown."""
    columns = document["columns"]
    lines = [[column["head"] for column in columns]]
    for row in document["rows"]:
        lines.append([cell(value_at(row, c["path"]), c.get("digits"), c.get("show")) for c in columns])
    head, *body = ["| " + " | ".join(line) + " |" for line in lines]
    table = "\n".join([head, "|" + "---|" * len(columns), *body])
    commit = document.get("commit")
    language = "text" if commit else "sh"
    commands = [*([f"# at commit {commit}"] if commit else []), *document["commands"]]
    return "\n".join([f"```{language}", *commands, "```", "", table, ""])


def renew(page: str, results: Path) -> str:
    """The page with every marked table anew. Raises ValueError naming a file that is missing, unused or unfit."""
    used = set()

    def replace(match: re.Match[str]) -> str:
        begin, name, end = match.groups()
        used.add(name)
        path = results / f"{name}.json"
        try:
            return begin + render(json.loads(path.read_text(encoding="utf-8"))) + end
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: {error!r}") from error

    renewed = MARKED.sub(replace, page)
    unused = sorted(path.name for path in results.glob("*.json") if path.stem not in used)
    if unused:
        raise ValueError(f"no table of the page is made from {', '.join(unused)}")
    return renewed


def main() -> int:
    """0: done, 1: page and results disagree, 2: a results file is missing, unused or unfit."""
    parser = argparse.ArgumentParser(description="Renew the tables of BENCHMARKS.md from benchmarks/results.")
    parser.add_argument("--check", action="store_true", help="write nothing; 1 where page and results disagree")
    options = parser.parse_args()
    page = PAGE.read_text(encoding="utf-8")
    try:
        renewed = renew(page, RESULTS)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    if options.check:
        if renewed != page:
            print("BENCHMARKS.md is not what benchmarks/results says: run benchmarks/tables.py", file=sys.stderr)
        return int(renewed != page)
    if renewed != page:
        draft = PAGE.with_suffix(".md.new")
        draft.write_text(renewed, encoding="utf-8")
        draft.replace(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
