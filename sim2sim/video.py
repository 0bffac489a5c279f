"""Pictures of played episodes: the robot with its reference shown through, beside the reference alone."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from core.errors import InputError
from robot.robot import Robot
from sim2sim.episode import EpisodeScore
from sim2sim.evaluation import Evaluation
from view.filmstrip import filmstrip
from view.stage import Stage
from view.video import VideoWriter

PANEL_WIDTH, PANEL_HEIGHT = 480, 480
STRIP_PICTURES, STRIP_COLUMNS = 8, 4


def write_video(path: Path, evaluation: Evaluation, meshes: Path | None = None) -> None:
    """The first episode of each policy, one panel each, and the reference in the last. Every second step is shown.

    meshes: folder of the maker's, see world.model.
    """
    episodes = [run.episodes[0] for run in evaluation.runs if len(run.episodes[0].qpos)]
    if not episodes:
        raise InputError("nothing to show: no episode reached the motion", where=path)
    fps = round(0.5 / evaluation.player.period_s)
    size = (PANEL_WIDTH * (len(episodes) + 1), PANEL_HEIGHT)
    with open_stage(evaluation.player.robot, meshes) as stage, VideoWriter(path, fps, size) as video:
        for frame in _side_by_side(stage, episodes):
            video.add(frame)


def open_stage(robot: Robot, meshes: Path | None = None) -> Stage:
    """Draws panels. meshes: folder of the maker's, see world.model."""
    return Stage(robot, PANEL_WIDTH, PANEL_HEIGHT, meshes)


def strip(stage: Stage, episode: EpisodeScore) -> np.ndarray:
    """Pictures at equal distances through an episode, in two rows, the reference shown through: (H,W,3) uint8."""
    rows = np.linspace(0, len(episode.qpos) - 1, STRIP_PICTURES).round().astype(int)
    pictures = [stage.picture(episode.qpos[row], episode.ref_qpos[row]) for row in rows]
    return filmstrip(pictures, columns=STRIP_COLUMNS)


def _side_by_side(stage: Stage, episodes: Sequence[EpisodeScore]) -> Iterator[np.ndarray]:
    """An episode that ended early stays at its last pose."""
    longest = max(episodes, key=lambda episode: len(episode.qpos))
    for row in range(0, len(longest.qpos), 2):
        rows = [min(row, len(episode.qpos) - 1) for episode in episodes]
        panels = [stage.picture(episode.qpos[i], episode.ref_qpos[i]) for episode, i in zip(episodes, rows)]
        yield np.concatenate([*panels, stage.picture(longest.ref_qpos[row])], axis=1)
