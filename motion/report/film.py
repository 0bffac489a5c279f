"""A clip as a video: the robot at its true speed, beside its joint angles and contacts with a moving cursor."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from motion.clip import Clip
from motion.report.figures import draw_contact
from motion.report.trace import Trace, trace_clip
from motion.resample import sample_clip
from robot.robot import Robot
from view.stage import Stage
from view.video import VideoWriter

MAX_PICTURES_PER_S = 30.0
SIZE_PX = 640  # of the picture and of the plot beside it, both square
PLOT_LEFT, PLOT_RIGHT, PLOT_BOTTOM, PLOT_TOP = 0.09, 0.98, 0.07, 0.96
LEGEND_SHARE = 0.3  # room above the curves
CURSOR_RGB = (200, 30, 30)


def film(clip: Clip, robot: Robot, path: Path, on_picture: Callable[[int, int], None] | None = None) -> None:
    """Write `clip` to `path` (.mp4), complete or not at all. `on_picture` hears of each picture: number and total.

    Raises InputError on joints that do not match, a path that cannot be written, or where videos cannot be made.
    """
    trace = trace_clip(clip, robot)
    rate = min(clip.fps, MAX_PICTURES_PER_S)
    times_s = np.arange(int(clip.duration_s * rate + 1e-9) + 1) / rate
    poses = _poses(clip, robot, times_s)
    with (
        Stage(robot, SIZE_PX, SIZE_PX, scene=clip.scene, plain=True) as stage,
        VideoWriter(path, rate, (2 * SIZE_PX, SIZE_PX)) as video,
    ):
        plot = joint_plot(trace, robot)
        for number, (qpos, time_s) in enumerate(zip(poses, times_s, strict=True), start=1):
            marked = with_cursor(plot, time_s / clip.duration_s)
            video.add(np.concatenate([stage.picture(qpos), marked], axis=1))
            if on_picture is not None:
                on_picture(number, len(times_s))


def joint_plot(trace: Trace, robot: Robot) -> np.ndarray:
    """Angles of left, right and other joints, and contacts, over time: (SIZE_PX, SIZE_PX, 3) uint8."""
    figure = Figure(figsize=(SIZE_PX / 100, SIZE_PX / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    groups = {name: columns for name, columns in _joint_groups(robot).items() if columns}
    rows = figure.subplots(len(groups) + 1, sharex=True, height_ratios=[1.0] * len(groups) + [0.3])
    figure.subplots_adjust(left=PLOT_LEFT, right=PLOT_RIGHT, bottom=PLOT_BOTTOM, top=PLOT_TOP, hspace=0.16)
    for axes, (group, columns) in zip(rows, groups.items(), strict=False):
        for column in columns:
            label = robot.joint_names[column].removeprefix(f"{group}_").removesuffix("_joint")
            axes.plot(trace.time_s, trace.joint_pos_rad[:, column], linewidth=1.0, label=label)
        axes.set_title(f"{group} joints (rad)", fontsize=8, loc="left", pad=2, y=1.0)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + LEGEND_SHARE * (high - low))
        axes.legend(fontsize=6, ncols=4, loc="upper right", framealpha=0.6, borderpad=0.2, handlelength=1.0)
        axes.grid(alpha=0.3)
    draw_contact(rows[-1], trace)
    rows[-1].set(xlim=(0.0, trace.time_s[-1]))
    rows[-1].set_xlabel("time (s)", fontsize=8)
    for axes in rows:
        axes.tick_params(labelsize=7)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def with_cursor(plot: np.ndarray, share: float) -> np.ndarray:
    """A copy of `plot` with a line at `share` (0 to 1) of its time axis."""
    marked = plot.copy()
    column = round((PLOT_LEFT + share * (PLOT_RIGHT - PLOT_LEFT)) * SIZE_PX)
    top, bottom = round((1.0 - PLOT_TOP) * SIZE_PX), round((1.0 - PLOT_BOTTOM) * SIZE_PX)
    marked[top:bottom, column - 1 : column + 1] = CURSOR_RGB
    return marked


def _joint_groups(robot: Robot) -> dict[str, list[int]]:
    """Columns of the joints by the first word of their names: left, right, other."""
    sides = [name.split("_")[0] for name in robot.joint_names]
    groups = {side: [i for i, found in enumerate(sides) if found == side] for side in ("left", "right")}
    return groups | {"other": [i for i, found in enumerate(sides) if found not in groups]}


def _poses(clip: Clip, robot: Robot, times_s: np.ndarray) -> np.ndarray:
    """(T,7+J) at `times_s` (T,)."""
    samples = sample_clip(clip, times_s)
    joints = samples.joint_pos_rad[:, robot.joint_index(clip.joint_names)]
    return np.concatenate([samples.root_pos_w, samples.root_quat_wxyz, joints], axis=1)
