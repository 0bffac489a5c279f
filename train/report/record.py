"""A run as its folder tells it."""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from core.errors import InputError
from train.folder import CONFIG_FILE, METRICS_FILE, SUMMARY_FILE
from train.progress import read_rows
from train.report.choice import JudgedActor, evaluations


@dataclass(frozen=True)
class TrainingRecord:
    """What is known of a run.

    Attributes:
        name: of the run's folder.
        rows: of metrics.jsonl.
        document: the resolved configuration.
        summary: summary.json; empty while the run has not ended, as far as the folder tells.
        machine: see :func:`train.report.machine.machine_facts`; empty where not recorded.
        dumps: names of the dumps that NaNs have left.
    """

    name: str
    rows: Sequence[Mapping[str, Any]]
    document: Mapping[str, Any]
    summary: Mapping[str, Any] = field(default_factory=dict)
    machine: Mapping[str, str] = field(default_factory=dict)
    dumps: Sequence[str] = ()

    @property
    def motion(self) -> str:
        """The clip's name."""
        return Path(str(self.document["motion"] or self.document["motions"])).stem

    @property
    def outcome(self) -> str:
        """``completed``, ``stopped`` or ``not ended``."""
        return str(self.summary.get("outcome", "not ended"))

    @property
    def evaluations(self) -> list[JudgedActor]:
        """All evaluations; the one at a run's end is in the summary only."""
        exported = {"iteration": self.summary.get("exported_iteration"), **self.summary.get("evaluation", {})}
        return evaluations(self.rows, self.summary.get("last_evaluation", {}), exported)


def read_record(run_dir: Path) -> TrainingRecord:
    """Read a run's folder.

    Raises:
        InputError: no such folder, or not that of a run, or a file in it cannot be read.
    """
    if not run_dir.is_dir():
        raise InputError("no such folder", where=run_dir, expected="the folder of a run")
    document = _read(run_dir / CONFIG_FILE)
    if "motion" not in document:
        raise InputError("not a run's configuration", where=run_dir / CONFIG_FILE, expected="a file of train/run.py")
    rows = read_rows(run_dir / METRICS_FILE, sys.maxsize)
    summary = _read(run_dir / SUMMARY_FILE) if (run_dir / SUMMARY_FILE).exists() else {}
    if rows and summary.get("iterations") != rows[-1]["iteration"]:
        summary = {}  # of an earlier life of a resumed run
    return TrainingRecord(run_dir.name, rows, document, summary, summary.get("machine", {}), find_dumps(run_dir))


def find_dumps(run_dir: Path) -> list[str]:
    """Names of the NaN dumps in a run's folder."""
    return sorted(path.name for path in run_dir.glob("nan_dump_*.pt"))


def _read(path: Path) -> dict[str, Any]:
    """A YAML or JSON mapping."""
    try:
        text = path.read_text(encoding="utf-8")
        document = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    except OSError as error:
        raise InputError("cannot be read", where=path, got=error.strerror, expected="a file of a run") from error
    except (yaml.YAMLError, ValueError) as error:
        raise InputError("cannot be read", where=path, got=" ".join(str(error).split())[:200]) from error
    if not isinstance(document, dict):
        raise InputError("cannot be read", where=path, got=type(document).__name__, expected="a mapping")
    return document
