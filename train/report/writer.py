"""Writes a run's report.html: without a video while it trains, with one at its end."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco

from core.files import write_whole
from train.config import check
from train.folder import ACTOR_FILE, REPORT_FILE
from train.progress import TIME_PREFIX
from train.report.choice import RULE, explain
from train.report.figures import Drawing, draw
from train.report.page import no_video, page, video_section
from train.report.playback import play
from train.report.preset import nearest_preset
from train.report.record import TrainingRecord, find_dumps, read_record
from train.report.times import time_split
from train.report.video import film
from view.renderer import choose_backend

FILM_BUDGET_S = 20.0
NOT_YET = "it is drawn when the run ends"
# What missing libraries, OpenGL, the encoder, a full disk, an unfit actor and diverged physics raise.
_FILM_ERRORS = (ImportError, OSError, RuntimeError, ValueError, mujoco.FatalError)


class TrainingReport:
    """The report of one run.

    Args:
        run_dir: existing folder of the run.
        document: its resolved configuration.
        machine: see :func:`train.report.machine.machine_facts`.
    """

    def __init__(self, run_dir: Path, document: Mapping[str, Any], machine: Mapping[str, str]) -> None:
        self._run_dir = run_dir
        self._record = TrainingRecord(run_dir.name, [], document, machine=machine)
        self._preset = nearest_preset(document)
        self._drawn: tuple[Any, list[Drawing]] = None, []  # of which rows and evaluations, and the figures

    def refresh(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write the report of a run that goes on, with the rows of its iterations so far."""
        record = replace(self._record, rows=rows, dumps=find_dumps(self._run_dir))
        self._write(record, no_video(NOT_YET), self._figures(record))

    def finish(self, film_budget_s: float = FILM_BUDGET_S) -> Path:
        """Write the report of a run that has ended, from its folder; return the file.

        What keeps the video from being made is told in the report. It is drawn in about ``film_budget_s``, and last:
        who does not wait for it has a report without.
        """
        record = read_record(self._run_dir)
        record = replace(record, machine=record.machine or self._record.machine)
        drawn = self._figures(record)
        self._write(record, no_video("it was not waited for"), drawn)
        self._write(record, _film(self._run_dir, record.document, film_budget_s), drawn)
        return self._run_dir / REPORT_FILE

    def _figures(self, record: TrainingRecord) -> list[Drawing]:
        """Drawn anew where something was added since the last time."""
        shown = len(record.rows), record.evaluations
        if self._drawn[0] != shown:
            self._drawn = shown, draw(record.rows, record.evaluations)
        return self._drawn[1]

    def _write(self, record: TrainingRecord, film_section: str, drawn: Sequence[Drawing]) -> None:
        write_whole(self._run_dir / REPORT_FILE, page(record, self._preset, film_section, drawn).encode())


def story(rows: Sequence[Mapping[str, Any]], summary: Mapping[str, Any]) -> dict[str, Any]:
    """What the report says in words, for summary.json: the choice with its reason, and the time split in seconds."""
    record = TrainingRecord("", rows, {}, summary)
    parts = {part.title: part.seconds for part in time_split(rows)}
    return {"choice": {"why": explain(record.evaluations), "rule": RULE}, TIME_PREFIX + "split_s": parts}


def rebuild(run_dir: Path, film_budget_s: float) -> Path:
    """Write the report of any run anew from its folder; return the file. InputError if that is none of a run."""
    return TrainingReport(run_dir, read_record(run_dir).document, {}).finish(film_budget_s)


def _film(run_dir: Path, document: Mapping[str, Any], budget_s: float) -> str:
    if not (run_dir / ACTOR_FILE).is_file():
        return no_video("the run has exported no actor yet")
    try:
        choose_backend()  # without one no episode is played
        playback = play(run_dir, check(document))
        return video_section(film(playback, budget_s), playback)
    except _FILM_ERRORS as error:
        return no_video(" ".join(str(error).split()) or type(error).__name__)
