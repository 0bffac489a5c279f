"""The scores of an evaluation or of a deployment as a table on the console, with their definitions."""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from core.arguments import ArgumentParser, path_argument
from core.command import guarded
from core.errors import InputError
from core.text_table import text_table
from sim2sim.definitions import AVERAGING, GOAL_SCORES, SUCCESS, SURVIVAL, scores_in

Document = Mapping[str, Any]
WIDEST_TEXT = 200  # a definition, or a fault in words


def format_table(documents: Sequence[Document], names: Sequence[str]) -> str:
    """One row a score, one column a run, the definition at the end of the row; lines joined by newlines."""
    rows = score_rows(documents)
    if any("outcome" in document for document in documents):
        rows.insert(0, ("outcome", *(str(d.get("fault") or d.get("outcome", "")) for d in documents), "", ""))
    table = text_table(("", *names, "unit", ""), rows, range(1, 1 + len(names)), widest=WIDEST_TEXT)
    return f"{table}\n{AVERAGING}"


def score_rows(documents: Sequence[Document]) -> list[tuple[str, ...]]:
    """Label, a value of each run, unit and definition of every share and score that a run has."""
    rows: list[tuple[str, ...]] = []
    for rate, meaning in (("survival", SURVIVAL), ("success", SUCCESS)):
        if any(f"{rate}_rate" in document for document in documents):
            rows.append((rate, *(percent(document, f"{rate}_rate") for document in documents), "%", meaning))
    for score in scores_in(documents):
        cells = tuple(format_value(document["metrics"].get(score.key)) for document in documents)
        rows.append((score.label, *cells, score.unit, score.meaning))
    return rows


CLIP_SCORES = ("episode_length_ratio", "eg_mpbpe_mm", "empbpe_mm", "empjpe_mrad")
CLIP_RATES = {"survival_rate": "completed %", "success_rate": "success %"}


def clip_table(documents: Sequence[Document], names: Sequence[str]) -> str:
    """One row a clip, and one of their means: episodes completed, their length, errors until their end."""
    scores = {score.key: score for score in scores_in(documents)}
    keys = [*CLIP_SCORES, *(score.key for score in scores.values() if score in GOAL_SCORES)]
    rates = [rate for rate in CLIP_RATES if any(rate in document for document in documents)]
    labels = [f"{scores[key].label} {scores[key].unit}".strip() for key in keys]
    rows = []
    for name, document in zip(names, documents, strict=True):
        cells = (format_value(document["metrics"].get(key)) for key in keys)
        rows.append((name, *(percent(document, rate) for rate in rates), *cells))
    rows.append((f"all {len(documents)}", *_means(documents, rates, keys)))
    heads = ("clip", *(CLIP_RATES[rate] for rate in rates), *labels)
    return text_table(heads, rows, range(1, len(heads)), widest=WIDEST_TEXT)


def _means(documents: Sequence[Document], rates: Sequence[str], keys: Sequence[str]) -> list[str]:
    """Of the clips that have it, each counting alike."""
    shares = [[d[rate] for d in documents if rate in d] for rate in rates]
    cells = [f"{100.0 * sum(known) / len(known):.1f}" for known in shares]
    for key in keys:
        known = [d["metrics"][key]["mean"] for d in documents if d["metrics"].get(key)]
        cells.append(format_value({"mean": sum(known) / len(known), "std": 0.0} if known else None))
    return cells


def format_value(value: Mapping[str, float] | None) -> str:
    """`12.3 ± 0.4`, the mean alone where nothing deviates from it, or a dash for what cannot be known."""
    if value is None:
        return "-"
    digits = 1 if abs(value["mean"]) >= 10 else 3
    deviation = f" ± {value['std']:.{digits}f}" if value["std"] else ""
    return f"{value['mean']:.{digits}f}{deviation}"


def percent(document: Document, rate: str) -> str:
    """A share of the episodes, or a dash where it is not known."""
    return f"{100 * document[rate]:.1f}" if rate in document else "-"


def read_documents(path: Path) -> list[Document]:
    """The runs in a JSON file of `sim2sim/evaluate` or `deploy/run`. Raises InputError."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise InputError("cannot read the scores", where=path, got=error) from error
    documents = content.get("runs", [content]) if isinstance(content, dict) else []
    if not isinstance(documents, list) or not documents or not all(map(_has_scores, documents)):
        raise InputError("no scores in this file", where=path, expected="JSON of sim2sim/evaluate or deploy/run")
    return documents


def _has_scores(document: Any) -> bool:
    """Whether it is a run's object: metrics are unknown or have mean and deviation, and shares are numbers."""
    if not isinstance(document, dict) or not isinstance(document.get("metrics"), dict):
        return False
    known = [value for value in document["metrics"].values() if value is not None]
    numbers = [document.get(rate, 0.0) for rate in CLIP_RATES]
    numbers += [value.get(key) if isinstance(value, dict) else None for value in known for key in ("mean", "std")]
    return all(isinstance(number, int | float) for number in numbers)


@guarded
def main(arguments: Sequence[str]) -> int:
    """Print the tables of the given JSON files."""
    parser = ArgumentParser("sim2sim.table", description="Show scores as a table.", allow_abbrev=False)
    parser.add_argument("files", nargs="+", metavar="FILE", type=path_argument, help="JSON of an evaluation or a run")
    for path in parser.parse_args(arguments).files:
        documents = read_documents(path)
        print(format_table(documents, [str(d.get("motion", path.stem)) for d in documents]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
