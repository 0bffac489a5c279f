"""What a run tells people: console, TensorBoard, metrics.jsonl, curves.png, summary.json."""

import json
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from torch.utils.tensorboard import SummaryWriter

from core.files import write_whole
from train.curves import draw_curves
from train.folder import CURVES_FILE, METRICS_FILE

TIME_PREFIX = "time/"
DRAW_INTERVAL_S = 30.0


def finite_or_none(row: Mapping[str, Any]) -> dict[str, Any]:
    """Replace NaN and infinity, which JSON does not have, by None."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}


def read_rows(path: Path, last_iteration: int) -> list[dict[str, Any]]:
    """Rows of a metrics file up to ``last_iteration``; a line cut short by a kill ends the reading."""
    rows: list[dict[str, Any]] = []
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            break
        if row["iteration"] > last_iteration:
            break
        rows.append(row)
    return rows


class TrainingProgress:
    """Reports one row per iteration.

    Args:
        run_dir: where the files go.
        start_iteration: iterations done already (resume): later rows of an earlier life are dropped.
        console: where lines for people go; None: standard output.
        refresh: shows the rows elsewhere: at the first save, then whenever the curves are drawn.
    """

    def __init__(
        self,
        run_dir: Path,
        start_iteration: int = 0,
        console: TextIO | None = None,
        refresh: Callable[[Sequence[Mapping[str, Any]]], None] | None = None,
    ) -> None:
        self._run_dir, self._console, self._refresh = run_dir, console or sys.stdout, refresh
        self._is_refreshed, self._save_s, self._drawn_rows = False, 0.0, -1
        path = run_dir / METRICS_FILE
        self.rows = read_rows(path, start_iteration)
        write_whole(path, "".join(json.dumps(row) + "\n" for row in self.rows).encode())
        self._metrics = path.open("a")
        self._drawn_s = time.monotonic()
        self._board = SummaryWriter(str(run_dir / "tensorboard"), purge_step=start_iteration + 1)

    def add_save_s(self, seconds: float) -> None:
        """Remember time that saving took, for the next row."""
        self._save_s += seconds

    def take_save_s(self) -> float:
        """That time, which begins anew."""
        taken_s, self._save_s = self._save_s, 0.0
        return taken_s

    def say(self, text: str) -> None:
        """Print one line for people."""
        print(text, file=self._console, flush=True)

    def report(self, row: Mapping[str, Any]) -> None:
        """Take in the row of a finished iteration; ``row["iteration"]`` counts from 1."""
        plain = finite_or_none(row)
        self.rows.append(plain)
        self._metrics.write(json.dumps(plain, allow_nan=False) + "\n")
        self._metrics.flush()
        for name, value in plain.items():
            if isinstance(value, int | float) and name != "iteration":
                self._board.add_scalar(name, value, plain["iteration"])
        self.say(console_line(plain))

    def draw(self, *, at_once: bool = False) -> None:
        """Flush TensorBoard and refresh curves.png, ``at_once`` or when the picture is older than half a minute."""
        self._board.flush()
        due = at_once or time.monotonic() - self._drawn_s >= DRAW_INTERVAL_S
        if self._refresh is not None and (due or not self._is_refreshed):
            self._refresh(self.rows)
            self._is_refreshed = True
        if due:
            self.draw_curves()

    def draw_curves(self) -> None:
        """Leave curves.png of all rows, and nothing to refresh until it is half a minute old."""
        if len(self.rows) != self._drawn_rows:
            draw_curves(self.rows, self._run_dir / CURVES_FILE)
            self._drawn_rows = len(self.rows)
        self._drawn_s, self._is_refreshed = time.monotonic(), True

    def close(self) -> None:
        """Close the files."""
        self._metrics.close()
        self._board.close()


def console_line(row: Mapping[str, Any]) -> str:
    """One iteration in one line: errors in mm and mrad, never reward alone."""
    parts = [f"iteration {row['iteration']}", f"{row['samples'] / 1e6:.2f} M samples"]
    parts.append(f"{row['time/steps_per_s']:.0f} steps/s, {_duration(row['time/left_s'])} left")
    shown = (
        ("episode_length_ratio", "episode {:.2f}"),
        ("eg_mpbpe_mm", "Eg {:.0f} mm"),
        ("empbpe_mm", "Empbpe {:.0f} mm"),
        ("empjpe_mrad", "Empjpe {:.0f} mrad"),
        ("noise_std", "noise {:.2f}"),
        ("kl", "kl {:.3f}"),
    )
    parts += [text.format(row[name]) for name, text in shown if row.get(name) is not None]
    sigma = [f"{name.removeprefix('sigma/')} {value:.3g}" for name, value in row.items() if _is_shown_sigma(name)]
    if sigma:
        parts.append("sigma " + " ".join(sigma))
    if row.get("evaluation/score") is not None:
        parts.append(f"evaluation {row['evaluation/score']:.3f}")
    return " | ".join(parts)


def _is_shown_sigma(name: str) -> bool:
    return name in ("sigma/joint_position", "sigma/body_position_lower", "sigma/feet")


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "?"
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"
