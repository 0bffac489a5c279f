"""The picture of a run: the first panels of its report, errors in millimetres first."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from core.files import write_whole
from train.report.choice import evaluations
from train.report.figures import PANELS, curves, draw_panel, evaluated


def draw_curves(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the rows of metrics.jsonl to a PNG file, atomically."""
    figure = Figure(figsize=(13, 7))
    figure.subplots_adjust(left=0.05, right=0.985, top=0.95, bottom=0.07, wspace=0.16, hspace=0.28)
    judged = evaluations(rows)
    for axes, panel in zip(figure.subplots(2, 3).flat, PANELS[:6], strict=True):
        found = [*curves(panel, rows), *evaluated(panel, judged)]
        draw_panel(axes, panel, found)
        axes.set_title(f"{panel.title} [{panel.unit}]", fontsize=10)
        if found:
            axes.legend(fontsize=6)
    picture = io.BytesIO()
    FigureCanvasAgg(figure).print_png(picture)
    write_whole(path, picture.getvalue())
