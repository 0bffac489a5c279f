"""Stick figures in three dimensions: the motion as it was read, above what the robot makes of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from motion.clip import Clip
from motion.human.motion import JOINTS, PARENTS, HumanMotion
from motion.reference import joint_columns
from motion.report.figures import png_of
from robot.robot import Robot

INSTANTS = 6
SIDE_COLORS = {"left": "tab:blue", "right": "tab:orange"}
MIDDLE_COLOR, GROUND_COLOR = "#444444", "#aaaaaa"
GROUND_SHARE = 0.7  # edge of the patch of ground, of the height of the whole motion
VIEW_ELEVATION_DEG, VIEW_AZIMUTH_DEG = 12.0, 40.0  # from the front left of somebody who faces +x


@dataclass(frozen=True)
class PointTree:
    """Points (N,P,3) in the world at `fps`, the point above each (-1: none) and its name. The first is the root."""

    fps: float
    pos_w: np.ndarray
    parents: Sequence[int]
    names: Sequence[str]


def skeleton_of(motion: HumanMotion | Clip, robot: Robot) -> PointTree:
    """The 22 joints of a person, or the tracked points of `robot`, through all frames."""
    if isinstance(motion, HumanMotion):
        return PointTree(motion.fps, motion.pos_w, PARENTS, JOINTS)
    model = robot.model
    above = [int(parent) - 1 for parent in model.body_parentid[1:]]
    above += robot.body_index([point.parent for point in robot.points]).tolist()
    joint_pos = motion.joint_pos_rad[:, joint_columns(motion, robot)]
    bodies = robot.kinematics.forward(motion.root_pos_w, motion.root_quat_wxyz, joint_pos)
    return PointTree(motion.fps, bodies.pos_w, above, robot.tracked_names)


def before_and_after(rows: Sequence[tuple[str, PointTree]]) -> bytes:
    """One row of stick figures a skeleton, at the same instants of all; each stands on its own patch of ground."""
    duration_s = min((len(skeleton.pos_w) - 1) / skeleton.fps for _, skeleton in rows)
    figure = Figure(figsize=(10.0, 2.4 * len(rows)), dpi=100)
    FigureCanvasAgg(figure)
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.95, wspace=0.0, hspace=0.05)
    for row, (label, skeleton) in enumerate(rows):
        reach_m = float(skeleton.pos_w[..., 2].max())
        for column, time_s in enumerate(np.linspace(0.0, duration_s, INSTANTS)):
            axes = figure.add_subplot(len(rows), INSTANTS, row * INSTANTS + column + 1, projection="3d")
            frame = min(round(time_s * skeleton.fps), len(skeleton.pos_w) - 1)
            _draw(axes, skeleton, frame, max(reach_m, 0.5))
            axes.set_title(f"{label}, {time_s:.1f} s" if column == 0 else f"{time_s:.1f} s", fontsize=8, pad=0)
    return png_of(figure)


def _draw(axes: Any, skeleton: PointTree, frame: int, reach_m: float) -> None:
    points = skeleton.pos_w[frame]
    bones = [(point, above) for point, above in enumerate(skeleton.parents) if above >= 0]
    colors = [SIDE_COLORS.get(skeleton.names[point].split("_")[0], MIDDLE_COLOR) for point, _ in bones]
    axes.add_collection3d(Line3DCollection([points[list(bone)] for bone in bones], colors=colors, linewidths=1.8))
    x, y = points[0, :2]
    half = 0.5 * GROUND_SHARE * reach_m
    square = np.array([(x + i * half, y + j * half, 0.0) for i, j in ((-1, -1), (-1, 1), (1, 1), (1, -1), (-1, -1))])
    axes.plot(*square.T, color=GROUND_COLOR, linewidth=0.8)
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), zlim=(0.0, reach_m))
    axes.set_box_aspect((GROUND_SHARE, GROUND_SHARE, 1.0), zoom=1.25)
    axes.view_init(VIEW_ELEVATION_DEG, VIEW_AZIMUTH_DEG)
    axes.set_axis_off()
