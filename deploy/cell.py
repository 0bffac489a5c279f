"""The one place where machine, guard, tick, recorder and timer of a run are wired to each other."""

from collections.abc import Callable, Sequence

from core.clock import Clock
from deploy.actor_run import ActorRun
from deploy.control.loop import Loop, Observer, Plan
from deploy.control.sequence import GantryRelease, OnlyTheClip, Unattended
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.control.timing import PhaseTimer
from deploy.operator.keys import RequestSource
from deploy.record.observers import Observers
from deploy.record.recorder import Recorder
from deploy.safety.guard import Guard
from deploy.settings import DeploySettings
from hal.contract.backend import Backend
from robot.robot import Robot


class Cell:
    """Everything that remembers and decides during one run; it serves one run and opens nothing.

    tracked: the actors to choose from, at least one, all of one control period; stand: balances between them.
    report_only: see Guard. fixed_stand: see StateMachine.
    """

    def __init__(
        self,
        robot: Robot,
        settings: DeploySettings,
        tracked: Sequence[ActorRun],
        stand: ActorRun | None = None,
        *,
        report_only: bool = False,
        fixed_stand: bool = False,
    ) -> None:
        self._settings, self._period_s = settings, tracked[0].period_s
        self.machine = StateMachine(robot, stand, tracked, settings, self._period_s, fixed_stand=fixed_stand)
        self.guard = Guard(robot, settings, self._period_s, report_only=report_only)
        self.tick = Tick(self.machine, self.guard)
        self.recorder = Recorder()
        self.timer = PhaseTimer()
        self.release = GantryRelease(settings, self._period_s)

    @property
    def performer(self) -> ActorRun:
        """Whose performance the recorder holds; where nobody performed, the actor that is selected."""
        return self.recorder.actor or self.machine.tracked[self.machine.selected]

    def start_tracking(self) -> Plan:
        """Begin in TRACKING, for a robot that was put at the clip's first frame; the plan ends with the clip."""
        self.machine.start_tracking()
        return OnlyTheClip(self.machine)

    def unattended(self) -> Plan:
        """The plan that stands up, plays the clip once and quits."""
        return Unattended(self.machine, self.release, self._settings, self._period_s)

    def loop(
        self,
        backend: Backend,
        clock: Clock,
        *,
        plan: Plan | None,
        operators: Sequence[RequestSource] = (),
        observers: Sequence[Observer] = (),
        duration_s: float | None = None,
        complain: Callable[[str], None] | None = None,
    ) -> Loop:
        """The loop of this run on an open backend. observers: come after the recorder.

        complain: where an observer that raises is left out and that is said; None where it ends the run.
        """
        watching: list[Observer] = [self.recorder, *observers]
        return Loop(
            backend,
            clock,
            self.tick,
            operators=operators,
            plan=plan,
            release=self.release,
            observers=watching if complain is None else [Observers(watching, complain)],
            duration_s=duration_s,
            timer=self.timer,
        )
