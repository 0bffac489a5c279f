"""The video of a report: the robot with the reference shown through it, and beside it the reference alone."""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from train.mdp.tracking import CONTROL_PERIOD_S
from train.report.playback import Playback
from view.stage import Stage
from view.video import VideoWriter

SIZE_PX = 400
MAX_PICTURES = 300
MIN_PICTURES = 20
_TRIED_PICTURES = 2


@dataclass(frozen=True)
class Video:
    """MP4 with its rate."""

    mp4: bytes
    pictures_per_s: float


def film(playback: Playback, budget_s: float) -> Video:
    """Film an episode at its true speed, with as many of its steps as can be drawn in about ``budget_s``.

    An episode that ends early stays at its last pose. Raises InputError where videos or pictures cannot be made here.
    """
    with (
        Stage(playback.robot, SIZE_PX, SIZE_PX, scene=playback.scene, plain=True) as stage,
        tempfile.TemporaryDirectory() as folder,
    ):
        stride = _stride(len(playback.ref_qpos), _pair_s(stage, playback), budget_s)
        path, rate = Path(folder) / "episode.mp4", 1.0 / (stride * CONTROL_PERIOD_S)
        with VideoWriter(path, rate, (2 * SIZE_PX, SIZE_PX)) as writer:
            for picture in _pairs(stage, playback, stride):
                writer.add(picture)
        return Video(path.read_bytes(), rate)


def _pair(stage: Stage, playback: Playback, tick: int) -> np.ndarray:
    reference = playback.ref_qpos[tick]
    robot = playback.qpos[min(tick, len(playback.qpos) - 1)]
    return np.concatenate([stage.picture(robot, reference), stage.picture(reference)], axis=1)


def _pairs(stage: Stage, playback: Playback, stride: int) -> Iterator[np.ndarray]:
    return (_pair(stage, playback, tick) for tick in range(0, len(playback.ref_qpos), stride))


def _pair_s(stage: Stage, playback: Playback) -> float:
    """What a pair of pictures costs; the first one, which prepares much, does not count."""
    _pair(stage, playback, 0)
    begun_s = time.monotonic()
    for _ in range(_TRIED_PICTURES):
        _pair(stage, playback, 0)
    return (time.monotonic() - begun_s) / _TRIED_PICTURES


def _stride(ticks: int, pair_s: float, budget_s: float) -> int:
    """Ticks from one picture to the next: two, or more where there are too many for the file or for the time."""
    affordable = min(MAX_PICTURES, max(MIN_PICTURES, int(budget_s / max(pair_s, 1e-6))))
    return max(2, -(-ticks // affordable))
