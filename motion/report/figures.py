"""The plots of a motion's report over time, as PNG bytes: balance, feet, joints against their limits."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from motion.physics_checks import STABLE_DISTANCE_M, phases
from motion.report.trace import Trace
from robot.robot import Robot

SIDES = ("left", "right")
FOOT_COLORS = ("tab:blue", "tab:orange")
LIMIT_COLOR, FAIL_COLOR, AIR_COLOR = "tab:red", "#f3b8b2", "#dddddd"
GRID_COLUMNS = 4
BALANCE_CAPTION = "dashed: Eq. 1's threshold; red: frames that break a rule of the filter; grey: in the air"
LEAST_SPAN_MM = 2.0  # on either side of 0, so that rounding does not fill a plot
FEET_CAPTION = "bars: the foot's contact, pale below one half; only feet in contact float and slide"
ANGLES_CAPTION = "dashed: the joint's range; dots: outside"
SPEEDS_CAPTION = "dashed: the joint's limits; dots: beyond"
HIGHEST_SHOWN = 3.0  # of the threshold: what lies above is cut off


@dataclass(frozen=True)
class Balance:
    """Distance (N,) from centre of mass to centre of pressure of a motion, m, infinite in the air; its frames that
    fail (K,)."""

    label: str
    fps: float
    distance_m: np.ndarray
    failing_frames: np.ndarray


def balance_over_time(motions: Sequence[Balance]) -> bytes:
    """Eq. 1's distance in mm with its threshold; red: frames that fail, grey: in the air."""
    figure = _figure(height_in=0.4 + 1.9 * len(motions))
    threshold_mm = 1e3 * STABLE_DISTANCE_M
    for axes, motion in zip(figure.subplots(len(motions), squeeze=False)[:, 0], motions, strict=True):
        time_s, distance_mm = np.arange(len(motion.distance_m)) / motion.fps, 1e3 * motion.distance_m
        failing = np.zeros(len(time_s), dtype=bool)
        failing[motion.failing_frames] = True
        _shade(axes, failing, motion.fps, FAIL_COLOR)
        _shade(axes, ~np.isfinite(distance_mm), motion.fps, AIR_COLOR)
        axes.plot(time_s, np.where(np.isfinite(distance_mm), distance_mm, np.nan), linewidth=1.2)
        axes.axhline(threshold_mm, color=LIMIT_COLOR, linestyle="--", linewidth=1.0)
        axes.set(xlim=(0.0, time_s[-1]), ylim=(0.0, _top(distance_mm, threshold_mm)))
        _dress(axes, f"{motion.label}: distance from centre of mass to centre of pressure (mm)")
    axes.set_xlabel("time (s)", fontsize=8)
    return png_of(figure)


def feet_over_time(trace: Trace) -> bytes:
    """Contact bars, the height of each sole's lowest point, and how far each contact slides."""
    figure = _figure(height_in=5.4)
    bars, heights, slides = figure.subplots(3, sharex=True, height_ratios=(0.7, 1.0, 1.0))
    draw_contact(bars, trace)
    for foot, (side, color) in enumerate(zip(SIDES, FOOT_COLORS, strict=True)):
        standing = trace.contact[:, foot] > 0.5
        height_mm = 1e3 * trace.lowest_sole_m[:, foot]
        heights.plot(trace.time_s, np.where(standing, height_mm, np.nan), color=color, label=f"{side}, in contact")
        mine = [slide for slide in trace.slides if slide.foot == foot]
        slides.bar(
            [slide.first / trace.fps for slide in mine],
            [1e3 * slide.way_m for slide in mine],
            [(slide.end - slide.first) / trace.fps for slide in mine],
            align="edge", facecolor=(color, 0.35), edgecolor=color, label=side,
        )  # fmt: skip
    heights.plot(trace.time_s, -1e3 * trace.penetration_m, color=LIMIT_COLOR, linewidth=0.8, label="any body")
    _dress(bars, "Contact")
    _dress(heights, "Lowest point (mm): above 0 a standing foot floats, below 0 a body is in the ground", legend=True)
    _dress(slides, "Sliding of each contact (mm)", legend=True)
    heights.set_ylim(min(heights.get_ylim()[0], -LEAST_SPAN_MM), max(heights.get_ylim()[1], LEAST_SPAN_MM))
    slides.set(xlim=(0.0, trace.time_s[-1]), ylim=(0.0, max(slides.get_ylim()[1], LEAST_SPAN_MM)))
    slides.set_xlabel("time (s)", fontsize=8)
    return png_of(figure)


def draw_contact(axes: Axes, trace: Trace) -> None:
    """A bar for each foot where it stands, paler where the contact is between 0 and 1."""
    for foot, color in enumerate(FOOT_COLORS):
        for level, opacity in ((trace.contact[:, foot] > 0.0, 0.3), (trace.contact[:, foot] > 0.5, 0.7)):
            spans = [(first / trace.fps, (end - first) / trace.fps) for first, end in phases(level)]
            axes.broken_barh(spans, (0.6 - foot, 0.8), color=color, alpha=opacity, linewidth=0)
    axes.set_yticks([1.0, 0.0], SIDES)
    axes.set_ylim(-0.6, 1.6)


def joint_angles(trace: Trace, robot: Robot) -> bytes:
    """Each joint's angle in rad, its range dashed, frames outside as red dots."""
    limits = np.stack([robot.pos_lower_rad, robot.pos_upper_rad], axis=1)
    return _joint_grid(trace.time_s, trace.joint_pos_rad, limits, trace.position_violations, robot, "rad")


def joint_speeds(trace: Trace, robot: Robot) -> bytes:
    """Each joint's speed in rad/s, its limits dashed, frames beyond as red dots."""
    limits = np.stack([-robot.vel_limit_rad_s, robot.vel_limit_rad_s], axis=1)
    return _joint_grid(trace.time_s[1:], trace.joint_vel_rad_s, limits, trace.speed_violations, robot, "rad/s")


def png_of(figure: Figure) -> bytes:
    """The figure as a file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _joint_grid(
    time_s: np.ndarray, values: np.ndarray, limits: np.ndarray, wrong: np.ndarray, robot: Robot, unit: str
) -> bytes:
    """One small plot a joint: values and wrong (T,J), limits (J,2)."""
    rows = -(-robot.num_joints // GRID_COLUMNS)
    figure = Figure(figsize=(10.0, 0.3 + 1.25 * rows), dpi=100)
    FigureCanvasAgg(figure)
    places = figure.subplots(rows, GRID_COLUMNS, sharex=True, squeeze=False).flat
    figure.subplots_adjust(left=0.04, right=0.995, top=1.0 - 0.25 / rows, bottom=0.25 / rows, hspace=0.45, wspace=0.2)
    for joint, axes in enumerate(places):
        if joint >= robot.num_joints:
            axes.set_axis_off()
            continue
        axes.plot(time_s, values[:, joint], linewidth=0.9)
        for limit in limits[joint]:
            axes.axhline(limit, color=LIMIT_COLOR, linestyle="--", linewidth=0.8)
        axes.plot(time_s[wrong[:, joint]], values[wrong[:, joint], joint], ".", color=LIMIT_COLOR, markersize=3)
        axes.set_title(
            f"{robot.joint_names[joint].removesuffix('_joint')} ({unit})", fontsize=7, loc="left", pad=2, y=1.0
        )
        axes.tick_params(labelsize=6, length=2, pad=1)
        axes.grid(alpha=0.3)
    return png_of(figure)


def _figure(height_in: float) -> Figure:
    figure = Figure(figsize=(10.0, height_in), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _dress(axes: Axes, title: str, *, legend: bool = False) -> None:
    axes.set_title(title, fontsize=9, loc="left", y=1.0)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    if legend:
        axes.legend(fontsize=7, loc="upper right")


def _shade(axes: Axes, frames: np.ndarray, fps: float, color: str) -> None:
    for first, end in phases(frames):
        axes.axvspan((first - 0.5) / fps, (end - 0.5) / fps, color=color, linewidth=0)


def _top(distance_mm: np.ndarray, threshold_mm: float) -> float:
    finite = distance_mm[np.isfinite(distance_mm)]
    return float(np.clip(1.1 * finite.max(initial=0.0), 1.2 * threshold_mm, HIGHEST_SHOWN * threshold_mm))
