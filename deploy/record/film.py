"""Frames of a run with what is asked as a ghost, remembered while it runs and drawn afterwards."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import mujoco
import numpy as np

from core.files import check_output_kind
from deploy.control.modes import Mode
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.recorder import Recorder
from hal.contract.types import RobotState
from view.filmstrip import StripWriter
from view.renderer import open_renderer
from view.video import VideoWriter

FRAMES_PER_S = 25
SIZE = (640, 480)
STRIP_PICTURES, STRIP_COLUMNS, STRIP_SIZE = 8, 4, (220, 240)


def state_qpos(state: RobotState, default_height_m: float) -> np.ndarray:
    """(7 + J,) root and joints as MuJoCo holds them; where the root is not known it stands at the default height."""
    truth = state.truth
    if truth is None:
        root = (np.array([0.0, 0.0, default_height_m]), state.imu_quat_wxyz, state.joint_pos_rad)
    else:
        root = (truth.root_pos_w, truth.root_quat_wxyz, truth.joint_pos_rad)
    return np.concatenate(root)


def ghost_qpos(recorder: Recorder, result: TickResult) -> np.ndarray | None:
    """(7 + J,) of what is asked at this tick, as the recorder lays it; None outside TRACKING."""
    goal = None if result.actor is None else result.actor.goal
    if result.mode is not Mode.TRACKING or goal is None or recorder.laid is None:
        return None
    row, reference = min(goal.tick, goal.reference.num_ticks), goal.reference
    position, rotation = reference.root_pos_w[row], reference.root_quat_wxyz[row]
    return np.concatenate([
        recorder.laid.points(position), recorder.laid.rotations(rotation), reference.joint_pos_rad[row]
    ])  # fmt: skip


class Film:
    """An observer that keeps what a video (.mp4) or a strip of pictures (.png) needs. period_s: of the control loop.

    Raises InputError at once where none could be written there.
    """

    def __init__(self, path: Path, recorder: Recorder, default_height_m: float, period_s: float) -> None:
        check_output_kind(path, (".mp4", ".png"))
        self._strip = path.suffix.lower() == ".png"
        self._size = STRIP_SIZE if self._strip else SIZE
        self._writer: StripWriter | VideoWriter = (
            StripWriter(path, STRIP_COLUMNS) if self._strip else VideoWriter(path, FRAMES_PER_S, SIZE)
        )
        self._recorder = recorder
        self._height_m = default_height_m
        self._stride = max(1, round(1.0 / (FRAMES_PER_S * period_s)))
        self._tick = 0
        self._frames: list[tuple[np.ndarray, np.ndarray | None]] = []

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        self._tick += 1
        if state is None or self._tick % self._stride:
            return
        qpos = state_qpos(state, self._height_m)
        if np.isfinite(qpos).all():
            self._frames.append((qpos, ghost_qpos(self._recorder, result)))

    def draw(self, model: mujoco.MjModel, enough: Callable[[], bool]) -> bool:
        """Write the file. `enough` is asked before each frame; True leaves no file, and the answer is False,
        as it is where there was nothing to see.
        """
        if not self._frames:
            return False
        data = mujoco.MjData(model)
        try:
            with closing(open_renderer(model, *self._size)) as renderer, self._writer as video:
                for qpos, ghost in self._chosen():
                    if enough():
                        raise _Enough
                    data.qpos[:] = qpos
                    mujoco.mj_forward(model, data)
                    video.add(renderer.render(data, ghost_qpos=ghost))
        except _Enough:
            return False
        return True

    def _chosen(self) -> list[tuple[np.ndarray, np.ndarray | None]]:
        """All frames, or for a strip some at equal distances, of TRACKING where there are."""
        if not self._strip:
            return self._frames
        frames = [frame for frame in self._frames if frame[1] is not None] or self._frames
        return [frames[row] for row in np.linspace(0, len(frames) - 1, STRIP_PICTURES).round().astype(int)]


class _Enough(Exception):
    """Nobody waits for the video any more; the writer throws away what it has."""
