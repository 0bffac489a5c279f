"""The one place where machine, guard, tick, recorder and loop are put together, for runs and episodes alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.clock import Clock
from core.errors import InputError
from deploy.control.actor_run import ActorRun
from deploy.control.loop import Loop, Observer, Plan
from deploy.control.sequence import BandRelease, OnlyTheClip, Unattended
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.control.timing import PhaseTimer
from deploy.operator.keys import RequestSource
from deploy.record.recorder import Recorder
from deploy.safety.guard import Guard
from deploy.settings import DeploySettings
from hal.contract.backend import Backend, Placeable
from robot.robot import Robot


class Cell:
    """What remembers and decides during one run; made anew for each.

    actors: to choose from. stand: what balances before and after, or None. report_only: the limits on targets and
    torques only count. All actors have the control period ``period_s``.
    """

    def __init__(
        self,
        robot: Robot,
        settings: DeploySettings,
        actors: Sequence[ActorRun],
        stand: ActorRun | None,
        *,
        report_only: bool = False,
    ) -> None:
        self.period_s = check_same_period([*actors, *([] if stand is None else [stand])])
        self.machine = StateMachine(robot, stand, actors, settings, self.period_s)
        self.guard = Guard(robot, settings, self.period_s, report_only=report_only)
        self.recorder, self.timer = Recorder(), PhaseTimer()
        self._settings, self._release = settings, BandRelease(settings, self.period_s)

    @property
    def performer(self) -> ActorRun:
        """Whose performance was recorded last; before there is one, the actor that is selected."""
        return self.recorder.performer or self.machine.tracked[self.machine.selected]

    def unattended(self) -> Plan:
        """Asks for one step after the other: stand up, play the clip once, stand, damp."""
        return Unattended(self.machine, self._release, self._settings, self.period_s)

    def begin_at_reference(self, backend: Placeable, start_noise_rad: float, rng: np.random.Generator) -> Plan:
        """Put a simulated robot at the clip's first frame, at rest, each joint off by a normal of this std.

        The plan plays the clip alone. Raises InputError on an actor without a reference.
        """
        actor = self.machine.tracked[self.machine.selected]
        reference = actor.reference
        if reference is None:
            raise InputError("the actor has no reference motion to start at", where=actor.actor.path)
        joints = reference.joint_pos_rad[0] + rng.normal(0.0, start_noise_rad, len(reference.joint_pos_rad[0]))
        backend.reset_to(reference.root_pos_w[0], reference.root_quat_wxyz[0], joints, rng=rng)
        self.machine.start_tracking()
        return OnlyTheClip(self.machine)

    def loop(
        self,
        backend: Backend,
        clock: Clock,
        *,
        plan: Plan | None = None,
        operators: Sequence[RequestSource] = (),
        observers: Sequence[Observer] = (),
        duration_s: float | None = None,
    ) -> Loop:
        """The loop that runs all of it; the recorder sees each tick before ``observers`` do."""
        return Loop(
            backend,
            clock,
            Tick(self.machine, self.guard),
            operators=operators,
            plan=plan,
            release=self._release,
            observers=[self.recorder, *observers],
            duration_s=duration_s,
            timer=self.timer,
        )


def check_same_period(runs: Sequence[ActorRun]) -> float:
    """The control period of all actors, in s. Raises InputError where they differ."""
    periods = {run.period_s for run in runs}
    if len(periods) > 1:
        got = ", ".join(f"{run.name} {run.period_s:g} s" for run in runs)
        raise InputError("actors of different control periods cannot share a loop", got=got)
    return periods.pop()
