"""The curves of a report, as SVG: errors in millimetres first, the reward last, for it falls as sigma tightens."""

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from train.report.choice import JudgedActor, best

MAX_POINTS = 400
_REWARD = "reward/"

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Curve:
    """Values (n,) at iterations (n,); ``dots``: each is one evaluation."""

    label: str
    iterations: np.ndarray
    values: np.ndarray
    dots: bool = False


@dataclass(frozen=True)
class Panel:
    """One figure: ``keys`` of rows (those that end in / are sections), ``evaluated``: ends of evaluations' figures."""

    title: str
    unit: str
    keys: tuple[str, ...]
    evaluated: tuple[str, ...] = ()
    logarithmic: bool = False
    caption: str = ""


@dataclass(frozen=True)
class Drawing:
    """A figure with its words."""

    title: str
    caption: str
    svg: bytes


PANELS = (
    Panel(
        "Body position error", "mm", ("eg_mpbpe_mm", "empbpe_mm"), ("eg_mpbpe_mm", "empbpe_mm"),
        caption="Lines: mean over all training environments, which start anywhere and meet the noise, pushes and "
        "randomisation of the moment. Dots: evaluations. Eg-mpbpe in the world, Empbpe relative to the root.",
    ),
    Panel("Joint error", "mrad", ("empjpe_mrad",), ("empjpe_mrad",), caption="Norm over all joints (Empjpe)."),
    Panel(
        "Survival", "share", ("survival_of_uniform_starts", "survival_chance", "episode_length_ratio"),
        ("falls", "length_ratio"),
        caption="survival_of_uniform_starts: episodes from uniformly drawn starts that end without failing. "
        "survival_chance: of five seconds, at the present rates of failures in each half second. Dots: evaluated "
        "starts that did not fall, and how much of the clip they got through (length_ratio).",
    ),
    Panel("Adaptive sigma", "of its first value", ("sigma/",), logarithmic=True, caption="PBHC Eq. 8."),
    Panel(
        "Curricula", "value", ("error_limit_m", "penalty_scale", "randomization"),
        caption="Error limit in m; penalties and randomisation as shares of their full size.",
    ),
    Panel("Learner", "value", ("learning_rate", "kl", "noise_std"), logarithmic=True),
    Panel(
        "World model", "of constant velocities' error", ("open_loop/",), logarithmic=True,
        caption="Median error of each part of the state after 1, 4, 16 and 32 steps of its own, on the newest steps, "
        "over the error of a robot whose velocities never change.",
    ),
    Panel(
        "Foretold and real", "value", ("foretold/",),
        caption="From the same states, without noise on actions: mean cost, and the share of robots that last for the "
        "horizon, as imagined and as simulated.",
    ),
    Panel(
        "Imagined cost", "per step", ("imagined/cost", "imagined/points", "imagined/place", "imagined/orientation",
        "imagined/joints", "imagined/joint_speeds", "imagined/velocity", "imagined/spin"), logarithmic=True,
        caption="What the policy learns by, weighted.",
    ),
    Panel(
        "Distillation", "value", ("distil/",), logarithmic=True,
        caption="action: mean square of what the student is off the teacher, with the encoder's latent; "
        "deployed: with the prior's mean. kl: from the prior to the encoder, in nats.",
    ),
    Panel("Who acts", "share of robots", ("acts/",), caption="The teacher, or the student in one of its ways."),
    Panel(
        "Error by kind of goal", "mm", ("goal/",), logarithmic=True,
        caption="Empbpe over all training environments, by what of the reference they are shown.",
    ),
    Panel("Speed", "steps/s", ("time/steps_per_s",), caption="Control steps of all environments per second."),
    Panel(
        "Reward", "per step", (_REWARD,),
        caption="Sum of all terms. Not a measure of progress: sigma shrinks with the errors, and with it the reward.",
    ),
)  # fmt: skip


def draw(rows: Rows, judged: Sequence[JudgedActor] = ()) -> list[Drawing]:
    """The panels for which the rows of metrics.jsonl hold something; a line stands at the best evaluation."""
    chosen = best(judged)
    mark = None if chosen is None else chosen.iteration
    drawn = ((panel, [*curves(panel, rows), *evaluated(panel, judged)]) for panel in PANELS)
    return [Drawing(panel.title, panel.caption, _svg(panel, found, mark)) for panel, found in drawn if found]


def curves(panel: Panel, rows: Rows) -> Iterator[Curve]:
    """Curves of the training: long ones as means over spans of equal length, sigma relative to its first value."""
    names = dict.fromkeys(name for row in rows for name in row)
    if panel.keys == (_REWARD,):
        yield from _reward_sum(rows)
        return
    for name in names:
        if not any(name == key or (key.endswith("/") and name.startswith(key)) for key in panel.keys):
            continue
        iterations, values = _points(rows, name)
        if not len(values):
            continue
        if name.startswith("sigma/"):
            values = values / (values[0] or 1.0)
        yield Curve(name.rpartition("/")[2], *thinned(iterations, values))


def evaluated(panel: Panel, judged: Sequence[JudgedActor]) -> Iterator[Curve]:
    """The evaluations' figures that belong into a panel; falls are turned into who has not fallen."""
    for name in dict.fromkeys(name for one in judged for name in one.figures):
        if not any(name.endswith(f"_{key}") for key in panel.evaluated):
            continue
        iterations, values = _points([{"iteration": one.iteration, **one.figures} for one in judged], name)
        if name.endswith("_falls"):
            name, values = name.removesuffix("falls") + "not_fallen", 1.0 - values
        if len(values):
            yield Curve(name, iterations, values, dots=True)


def thinned(iterations: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """At most MAX_POINTS points: means over neighbouring ones."""
    span = -(-len(values) // MAX_POINTS)
    if span <= 1:
        return iterations, values
    starts = np.arange(0, len(values), span)
    counts = np.diff(np.append(starts, len(values)))
    return np.add.reduceat(iterations, starts) / counts, np.add.reduceat(values, starts) / counts


def _reward_sum(rows: Rows) -> Iterator[Curve]:
    sums = [
        (row["iteration"], sum(value or 0.0 for name, value in row.items() if name.startswith(_REWARD))) for row in rows
    ]
    if any(name.startswith(_REWARD) for name in (rows[-1] if rows else ())):
        iterations, values = np.array(sums, dtype=float).T
        yield Curve("sum", *thinned(iterations, values))


def _points(rows: Rows, name: str) -> tuple[np.ndarray, np.ndarray]:
    points = [(row["iteration"], row[name]) for row in rows if row.get(name) is not None]
    table = np.array(points, dtype=float).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def draw_panel(axes: Axes, panel: Panel, found: Sequence[Curve]) -> None:
    """Draw the curves of a panel, without its title, unit and legend."""
    for curve in found:
        style = {"marker": "o", "markersize": 4, "linewidth": 0.6} if curve.dots else {"linewidth": 1.2}
        axes.plot(curve.iterations, curve.values, label=curve.label, **style)
    if panel.logarithmic:
        axes.set_yscale("log")
    axes.set_xlabel("iteration", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)


def _svg(panel: Panel, found: Sequence[Curve], chosen: int | None) -> bytes:
    figure = Figure(figsize=(6.8, 2.9))
    FigureCanvasSVG(figure)
    figure.subplots_adjust(left=0.1, right=0.71, top=0.97, bottom=0.16)
    axes = figure.add_subplot()
    draw_panel(axes, panel, found)
    axes.set_ylabel(panel.unit, fontsize=8)
    if chosen is not None:
        axes.axvline(chosen, color="black", linestyle=":", linewidth=1.0, label="chosen")
    axes.legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.03), frameon=False)
    picture = io.BytesIO()
    # Text stays text, and the same curves give the same file.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "kata"}):
        figure.savefig(picture, format="svg", metadata={"Date": None})
    return picture.getvalue()
