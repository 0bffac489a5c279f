"""One control tick: what the robot said in, what it is told out. No clock, no device, no waiting."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deploy.actor_run import ActorRun
from deploy.control.modes import RESTING, Mode, Request
from deploy.control.states import StateMachine
from deploy.safety.guard import Guard
from deploy.safety.rules import Fault, Wish, make_sample
from hal.contract.types import DeviceError, RobotState
from policy.controller import PolicyOutput
from world.actuation import JointCommand


@dataclass(frozen=True, slots=True)
class TickResult:
    """command: to be written, or None: the joints are damped, or left alone in IDLE.

    modes: the states entered, in order. refused: answers to requests that could not be met. acknowledged: the devices
    are to clear what has latched. actor, output: who moved the joints and what it computed; None where none did.
    warning: what will end the run before long; it has asked for HOLD. lowered_by: what has asked for LOWER in this
    tick, because it will be very soon. finishing: an orderly end waits until the robot can be lowered. requests: what
    others asked for.
    """

    command: JointCommand | None
    mode: Mode
    modes: tuple[Mode, ...]
    fault: Fault | None
    refused: tuple[str, ...]
    acknowledged: bool
    actor: ActorRun | None
    output: PolicyOutput | None
    warning: str | None = None
    lowered_by: str | None = None
    finishing: bool = False
    requests: tuple[Request, ...] = ()


class Tick:
    """The step that the loop and the evaluation share. What decides is remembered by machine and guard alone.

    cut_short: what was foreseen and ended a clip in HOLD, or standing by lowering; None: nothing did.
    """

    def __init__(self, machine: StateMachine, guard: Guard) -> None:
        self.machine = machine
        self.guard = guard
        self.cut_short: str | None = None
        self._mode = Mode.IDLE

    def __call__(
        self,
        reading: RobotState | DeviceError,
        requests: Sequence[Request] = (),
        inference_s: float = 0.0,
        overran: bool = False,
        lap: Callable[[str], None] | None = None,
    ) -> TickResult:
        """reading: the state, or what prevented reading it. inference_s: how long the actor took a tick before.
        overran: whether that tick missed the deadline of this one.
        """
        machine, guard = self.machine, self.guard
        state = None if isinstance(reading, DeviceError) else guard.believed(reading)
        modes: list[Mode] = [] if machine.mode is self._mode else [machine.mode]
        self._mode = machine.mode
        if fault := self._fault_of(reading if state is None else state, inference_s, overran):
            machine.trip(fault)
        else:
            machine.no_fault()
        self._note(modes)
        lowered_by = self._foresee(state)
        self._note(modes)
        refused = []
        acknowledged = False
        for request in requests:
            before = machine.acknowledging
            if answer := machine.request(request, state):
                refused.append(answer)
            acknowledged = acknowledged or (machine.acknowledging and not before)
            self._note(modes)
        command = None if state is None else self._command(state, lap)
        self._note(modes)
        if command is None:
            guard.reset()
        output = None if state is None else machine.output
        return TickResult(
            command, machine.mode, tuple(modes), machine.fault, tuple(refused), acknowledged, machine.active, output,
            guard.warning, lowered_by, machine.finishing, tuple(requests),
        )  # fmt: skip

    def _foresee(self, state: RobotState | None) -> str | None:
        """End in order what a rule would soon damp: a clip in HOLD, standing by lowering. The reason for lowering."""
        machine, guard = self.machine, self.guard
        if guard.urgent is not None and machine.can_lower:
            machine.request(Request.LOWER, state)
            self.cut_short = self.cut_short or guard.urgent
            return guard.urgent
        warned = guard.warning is not None and machine.mode is Mode.TRACKING
        if warned and machine.request(Request.HOLD, state) is None:
            self.cut_short = self.cut_short or guard.warning
        return None

    def _fault_of(self, reading: RobotState | DeviceError, inference_s: float, overran: bool) -> Fault | None:
        if isinstance(reading, DeviceError):
            return self.guard.check_reading(reading)
        moving = self.machine.mode not in RESTING
        active = self.machine.active
        asked = None if active is None else active.asked
        falling = self.machine.mode is Mode.BRACING
        return self.guard.check(make_sample(reading, inference_s, overran, asked), moving=moving, falling=falling)

    def _command(self, state: RobotState, lap: Callable[[str], None] | None) -> JointCommand | None:
        machine, guard = self.machine, self.guard
        wish = machine.advance(state, lap)
        if isinstance(wish, Wish) and (fault := guard.check_action(wish, machine.output)):
            machine.trip(fault)
        elif isinstance(wish, Fault):
            machine.trip(guard.counted(wish))
        elif wish is not None:
            command = guard.command(wish, state)
            machine.sent(command)
            return command
        return None

    def _note(self, modes: list[Mode]) -> None:
        if self.machine.mode is not self._mode:
            self._mode = self.machine.mode
            modes.append(self._mode)
