"""The plots of a report, as PNG bytes. Each takes the episodes of one or several runs by name."""

import io
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imsave

from sim2sim.episode import EpisodeScore

Runs = Mapping[str, Sequence[EpisodeScore]]


def error_over_time(runs: Runs, period_s: float) -> bytes:
    """Eg-mpbpe in mm along the clip: mean over the episodes still running, and the 10th to 90th percentile."""
    figure, axes = _figure("Body position error along the clip", height_in=3.2)
    for name, episodes in runs.items():
        error_mm = stacked([episode.body_error_mm.mean(axis=1) for episode in episodes])
        alive = ~np.isnan(error_mm).all(axis=0)
        time_s = period_s * (1 + np.flatnonzero(alive))
        low, high = np.nanpercentile(error_mm[:, alive], (10, 90), axis=0)
        (line,) = axes.plot(time_s, np.nanmean(error_mm[:, alive], axis=0), label=name)
        axes.fill_between(time_s, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    axes.set(xlabel="time in the clip (s)", ylabel="Eg-mpbpe (mm)")
    return _png(figure, axes, runs)


def survival_over_time(runs: Runs, period_s: float) -> bytes:
    """Share of episodes along the clip that have not ended early yet, in %."""
    figure, axes = _figure("Episodes still running", height_in=2.2)
    for name, episodes in runs.items():
        percent = survival_percent(episodes)
        axes.step(period_s * np.arange(percent.size), percent, where="post", label=name)
    axes.set(xlabel="time in the clip (s)", ylabel="episodes (%)", ylim=(-2, 102))
    return _png(figure, axes, runs)


def survival_percent(episodes: Sequence[EpisodeScore]) -> np.ndarray:
    """(T + 1,) share of episodes, in %, that have not ended early after 0, 1, ... steps; T: steps of the longest."""
    lengths = np.array([len(episode.qpos) for episode in episodes])
    survived = np.array([episode.survived for episode in episodes])
    steps = np.arange(lengths.max(initial=0) + 1)
    return 100 * (survived | (lengths > steps[:, None])).mean(axis=1)


def error_per_body(runs: Runs, tracked_names: Sequence[str]) -> bytes:
    """World-frame position error of each tracked point in mm, mean over steps and episodes."""
    values = {name: _mean_rows([episode.body_error_mm for episode in episodes]) for name, episodes in runs.items()}
    return _bars("Position error of each tracked point", "mm", values, tracked_names)


def error_per_joint(runs: Runs, joint_names: Sequence[str]) -> bytes:
    """Absolute joint error in rad, mean over steps and episodes."""
    values = {
        name: _mean_rows([np.abs(episode.joint_error_rad) for episode in episodes]) for name, episodes in runs.items()
    }
    return _bars("Error of each joint", "rad", values, [name.removesuffix("_joint") for name in joint_names])


def picture_png(picture: np.ndarray) -> bytes:
    """A picture (H,W,3) uint8 as PNG."""
    buffer = io.BytesIO()
    imsave(buffer, picture, format="png")
    return buffer.getvalue()


def stacked(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Rows of different lengths under each other, NaN after the end of the shorter ones."""
    table = np.full((len(rows), max(len(row) for row in rows)), np.nan)
    for index, row in enumerate(rows):
        table[index, : len(row)] = row
    return table


def _mean_rows(arrays: Sequence[np.ndarray]) -> np.ndarray:
    return np.concatenate(arrays).mean(axis=0)


def _bars(title: str, unit: str, values: Mapping[str, np.ndarray], labels: Sequence[str]) -> bytes:
    figure, axes = _figure(title, height_in=1.0 + 0.18 * len(labels))
    places, thickness = np.arange(len(labels)), 0.8 / len(values)
    for index, (name, row) in enumerate(values.items()):
        axes.barh(places + (index - (len(values) - 1) / 2) * thickness, row, height=thickness, label=name)
    axes.set_yticks(places, labels, fontsize=7)
    axes.invert_yaxis()
    axes.set_xlabel(unit)
    return _png(figure, axes, values)


def _figure(title: str, height_in: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(9.0, height_in), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    return figure, axes


def _png(figure: Figure, axes: Axes, names: Mapping[str, object]) -> bytes:
    if len(names) > 1:
        axes.legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
