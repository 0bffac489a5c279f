"""The live window on a simulated run."""

from collections.abc import Sequence
from typing import Self

from deploy.control.modes import Request
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.film import ghost_qpos
from deploy.record.recorder import Recorder
from hal.contract.types import RobotState
from hal.simulated.mujoco import MujocoBackend
from view.viewer import LiveViewer


class ViewerObserver:
    """Shows every tick, and asks to quit once the window is closed. Raises InputError where no window opens."""

    def __init__(self, backend: MujocoBackend, recorder: Recorder) -> None:
        self._recorder = recorder
        self._window = LiveViewer(backend.model, backend.data)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._window.close()

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        self._window.show(ghost_qpos(self._recorder, result))

    def poll(self) -> Sequence[Request]:
        """See RequestSource."""
        return () if self._window.is_open else (Request.QUIT,)
