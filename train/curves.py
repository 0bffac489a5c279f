"""The picture of a run: errors in millimetres first, reward never alone (it falls as sigma tightens)."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from core.files import write_whole

_PANELS: tuple[tuple[str, tuple[str, ...], bool], ...] = (
    ("body errors [mm]", ("eg_mpbpe_mm", "empbpe_mm"), False),
    ("joint error [mrad]", ("empjpe_mrad",), False),
    ("episode length ratio", ("episode_length_ratio", "survival_chance", "falls"), False),
    ("sigma / start", ("sigma/",), True),
    ("curricula", ("error_limit_m", "penalty_scale", "randomization"), False),
    ("learner", ("learning_rate", "kl", "noise_std"), True),
)


def draw_curves(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the rows of metrics.jsonl to a PNG file, atomically."""
    figure = Figure(figsize=(13, 7))
    figure.subplots_adjust(left=0.05, right=0.985, top=0.95, bottom=0.07, wspace=0.16, hspace=0.28)
    for axes, (title, names, logarithmic) in zip(figure.subplots(2, 3).flat, _PANELS, strict=True):
        _panel(axes, rows, title, names, logarithmic=logarithmic)
    picture = io.BytesIO()
    FigureCanvasAgg(figure).print_png(picture)
    write_whole(path, picture.getvalue())


def _panel(
    axes: Axes, rows: Sequence[Mapping[str, Any]], title: str, names: tuple[str, ...], *, logarithmic: bool
) -> None:
    keys = dict.fromkeys(key for row in rows for key in row if _belongs(key, names))
    drawn = [key for key in keys if any(row.get(key) is not None for row in rows)]
    for key in drawn:
        points = [(row["iteration"], row[key]) for row in rows if row.get(key) is not None]
        x, y = zip(*points, strict=True)
        scale = y[0] if key.startswith("sigma/") and y[0] else 1.0
        style = {"marker": "o", "markersize": 3} if key.startswith("evaluation/") else {"linewidth": 1.0}
        axes.plot(x, [value / scale for value in y], label=key.removeprefix("sigma/"), **style)
    if logarithmic:
        axes.set_yscale("log")
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("iteration", fontsize=8)
    axes.grid(alpha=0.3)
    if drawn:
        axes.legend(fontsize=6)


def _belongs(key: str, names: tuple[str, ...]) -> bool:
    """Whether a figure, or an evaluation's figure of that name, is in the panel; names in / are sections."""
    judged = key.startswith("evaluation/")
    return any(key == n or (judged and key.endswith(n)) or (n.endswith("/") and key.startswith(n)) for n in names)
