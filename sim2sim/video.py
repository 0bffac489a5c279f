"""Pictures of played episodes: the robot with its reference shown through, beside the reference alone."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from core.errors import InputError
from sim2sim.episode import EpisodeScore
from sim2sim.evaluation import Evaluation
from view.filmstrip import filmstrip
from view.stage import Stage
from view.video import VideoWriter
from world.scene import Scene

PANEL_WIDTH, PANEL_HEIGHT = 480, 480
STRIP_PICTURES, STRIP_COLUMNS = 8, 4
Shown = tuple[Stage, EpisodeScore]


def write_video(path: Path, evaluation: Evaluation, meshes: Path | None = None) -> None:
    """The first episode of each policy, one panel each, and the reference in the last. Every second step is shown.

    meshes: folder of the maker's, see world.model.
    """
    runs = [run for run in evaluation.runs if len(run.episodes[0].qpos)]
    if not runs:
        raise InputError("nothing to show: no episode reached the motion", where=path)
    fps = round(0.5 / evaluation.player.period_s)
    size = (PANEL_WIDTH * (len(runs) + 1), PANEL_HEIGHT)
    with ExitStack() as stack:
        stages = open_stages(evaluation, meshes, stack)
        video = stack.enter_context(VideoWriter(path, fps, size))
        for frame in _side_by_side([(stages[run.scene], run.episodes[0]) for run in runs]):
            video.add(frame)


def open_stages(evaluation: Evaluation, meshes: Path | None, stack: ExitStack) -> dict[Scene, Stage]:
    """What draws a panel, for each scene of an evaluation; ``stack`` closes them."""
    robot = evaluation.player.robot
    return {
        scene: stack.enter_context(Stage(robot, PANEL_WIDTH, PANEL_HEIGHT, scene=scene, meshes=meshes))
        for scene in dict.fromkeys(run.scene for run in evaluation.runs)
    }


def strip(stage: Stage, episode: EpisodeScore) -> np.ndarray:
    """Pictures at equal distances through an episode, in two rows, the reference shown through: (H,W,3) uint8."""
    rows = np.linspace(0, len(episode.qpos) - 1, STRIP_PICTURES).round().astype(int)
    pictures = [stage.picture(episode.qpos[row], episode.ref_qpos[row]) for row in rows]
    return filmstrip(pictures, columns=STRIP_COLUMNS)


def _side_by_side(shown: Sequence[Shown]) -> Iterator[np.ndarray]:
    """An episode that ended early stays at its last pose."""
    stage, longest = max(shown, key=lambda one: len(one[1].qpos))
    for row in range(0, len(longest.qpos), 2):
        rows = [min(row, len(episode.qpos) - 1) for _, episode in shown]
        panels = [stage.picture(episode.qpos[i], episode.ref_qpos[i]) for (stage, episode), i in zip(shown, rows)]
        yield np.concatenate([*panels, stage.picture(longest.ref_qpos[row])], axis=1)
