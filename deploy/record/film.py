"""Frames of a run with its reference as a ghost, remembered while it runs and drawn afterwards."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from deploy.control.states import Mode
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.recorder import Recorder
from hal.contract.types import RobotState
from view.renderer import open_renderer
from view.video import VideoWriter

FRAMES_PER_S = 25
SIZE = (640, 480)


def state_qpos(state: RobotState, default_height_m: float) -> np.ndarray:
    """(7 + J,) root and joints as MuJoCo holds them; where the root is not known it stands at the default height."""
    truth = state.truth
    if truth is None:
        root = (np.array([0.0, 0.0, default_height_m]), state.imu_quat_wxyz, state.joint_pos_rad)
    else:
        root = (truth.root_pos_w, truth.root_quat_wxyz, truth.joint_pos_rad)
    return np.concatenate(root)


def ghost_qpos(recorder: Recorder, result: TickResult) -> np.ndarray | None:
    """(7 + J,) of the reference at this tick, laid where the robot started it; None outside TRACKING."""
    performance = recorder.performance
    if result.mode is not Mode.TRACKING or result.actor is None or performance is None:
        return None
    reference, heading = performance.reference, performance.heading
    row = min(result.actor.tick - 1, reference.num_ticks)
    position = heading.points(reference.root_pos_w[row])
    return np.concatenate([position, heading.rotations(reference.root_quat_wxyz[row]), reference.joint_pos_rad[row]])


class Film:
    """An observer that keeps what a video needs. period_s: of the control loop.

    Raises InputError at once where no video could be written there.
    """

    def __init__(self, path: Path, recorder: Recorder, default_height_m: float, period_s: float) -> None:
        self._writer = VideoWriter(path, FRAMES_PER_S, SIZE)
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
        """Write the MP4. `enough` is asked before each frame; True leaves no file, and the answer is False,
        as it is where there was nothing to see.
        """
        if not self._frames:
            return False
        data = mujoco.MjData(model)
        try:
            with open_renderer(model, *SIZE) as renderer, self._writer as video:
                for qpos, ghost in self._frames:
                    if enough():
                        raise _Enough
                    data.qpos[:] = qpos
                    mujoco.mj_forward(model, data)
                    video.add(renderer.render(data, ghost_qpos=ghost))
        except _Enough:
            return False
        return True


class _Enough(Exception):
    """Nobody waits for the video any more; the writer throws away what it has."""
