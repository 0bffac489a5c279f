"""Who asks for the next step when nobody is at the keyboard."""

from collections.abc import Sequence

from deploy.actor_run import unsteady
from deploy.control.modes import Mode, Request
from deploy.control.states import StateMachine
from deploy.settings import DeploySettings
from hal.contract.types import RobotState


class GantryRelease:
    """Says once when the gantry may go: after READY has been steady for long enough."""

    def __init__(self, settings: DeploySettings, period_s: float) -> None:
        self._entry = settings.entry
        self._needed = round(settings.sequence.steady_ready_s / period_s)
        self._steady = 0
        self.released = False

    def due(self, mode: Mode, state: RobotState | None) -> bool:
        """One tick."""
        if mode is not Mode.READY or state is None or unsteady(state, self._entry):
            self._steady = 0
            return False
        self._steady += 1
        if self.released or self._steady <= self._needed:
            return False
        self.released = True
        return True


class Unattended:
    """Stand up, wait for the gantry's release, play the clip once, hold, finish.

    failure: why a step's conditions never came; the run then finishes.
    """

    def __init__(
        self, machine: StateMachine, release: GantryRelease, settings: DeploySettings, period_s: float
    ) -> None:
        self._machine = machine
        self._release = release
        self._after_release = round(settings.sequence.after_release_s / period_s)
        self._hold = round(settings.sequence.hold_s / period_s)
        self._patience = round(settings.sequence.wait_s / period_s)
        self._mode = machine.mode
        self._in_mode = -1
        self._free = 0
        self.failure: str | None = None

    def requests(self, state: RobotState | None) -> Sequence[Request]:
        """One tick's wishes."""
        machine = self._machine
        self._in_mode = self._in_mode + 1 if machine.mode is self._mode else 0
        self._mode = machine.mode
        self._free += self._release.released
        match machine.mode:
            case Mode.IDLE | Mode.DAMPING if machine.latched:
                return (Request.FINISH,)
            case Mode.IDLE:
                return () if self._in_mode else (Request.STAND,)
            case Mode.READY if self._free > self._after_release and state is not None:
                self._give_up_if_late(machine.tracked[machine.selected].obstacle(state))
                return (Request.START,) if self.failure is None else (Request.FINISH,)
            case Mode.HOLD if self._in_mode >= self._hold:
                return (Request.FINISH,)
            case Mode.READY | Mode.STAND_UP | Mode.DAMPING:
                self._give_up_if_late("it is not steady")
        return () if self.failure is None else (Request.FINISH,)

    def _give_up_if_late(self, why: str | None) -> None:
        if why is not None and self._in_mode > self._patience:
            self.failure = f"{self._mode.name} never led on: {why}"


class OnlyTheClip:
    """Started in TRACKING: quit when the clip is over."""

    failure: str | None = None

    def __init__(self, machine: StateMachine) -> None:
        self._machine = machine

    def requests(self, state: RobotState | None) -> Sequence[Request]:
        """One tick's wishes."""
        machine = self._machine
        if machine.mode is Mode.BRACING:
            return ()
        over = machine.mode is not Mode.TRACKING or (machine.active is not None and machine.active.finished)
        return (Request.QUIT,) if over else ()
