"""The states of a running robot and every way between them.

    IDLE -> DAMPING -> STAND_UP [-> FIXED_STAND] -> READY -> TRACKING -> HOLD -> (next actor | DAMPING)

FIXED_STAND is passed where somebody must put the robot on its feet first: the start pose is held, nothing balances.

An orderly end lowers the robot first, READY or HOLD -> LOWERING -> DAMPING; inside a motion it waits for HOLD.
A balanced robot that falls passes BRACING, where its joints give way softly, until it has landed.
Then, and at once after any other fault and every operator's stop, it is in DAMPING, latched.
A fault in IDLE, where nothing is in force, latches IDLE.
Acknowledging leads to IDLE once the devices are without fault, never straight up.
"""

from collections.abc import Callable, Sequence

from deploy.actor_run import ActorRun
from deploy.control.bracing import FALLING, bracing_for
from deploy.control.lowering import lowering_for
from deploy.control.modes import ALLOWED, BALANCED, RISING, STANDING, Mode, Request
from deploy.control.stand_up import Settling, StandUp
from deploy.safety.rules import Fault, Wish
from deploy.settings import DeploySettings
from hal.contract.types import RobotState
from policy.controller import PolicyOutput
from robot.robot import Robot
from world.actuation import JointCommand


class StateMachine:
    """Which actor, if any, moves the joints now. Knows neither clock nor device: one call of `advance` is one tick.

    stand: balances in READY and HOLD; without it only `start_tracking` begins, and the clip's end is damped.
    tracked: the actors to choose from; `selected` is the next to start. fault: what latched, if a fault did.
    fixed_stand: whether the start pose is held until a second STAND; otherwise the stand actor takes over by itself.
    """

    def __init__(
        self,
        robot: Robot,
        stand: ActorRun | None,
        tracked: Sequence[ActorRun],
        settings: DeploySettings,
        period_s: float,
        *,
        fixed_stand: bool = False,
    ) -> None:
        self.mode = Mode.IDLE
        self.fault: Fault | None = None
        self.latched = False
        self.lowered = False  # brought down because somebody asked for the end, and told nothing since
        self.selected = 0
        self.tracked = tuple(tracked)
        self.active: ActorRun | None = None
        self.output: PolicyOutput | None = None
        self._stand, self._fixed_stand = stand, fixed_stand
        self._stand_up = None if stand is None else StandUp(robot, stand.start_pose_rad, settings.stand_up, period_s)
        self._lowering = None if stand is None else lowering_for(robot, stand.start_pose_rad, settings, period_s)
        self._bracing = bracing_for(robot, settings.bracing, period_s)
        self._settling = Settling(robot, settings.stand_up, period_s)
        self._blend_ticks = max(1, round(settings.blend_s / period_s))
        self._acknowledge_ticks = max(1, round(settings.acknowledge_s / period_s))
        self._patience = 0
        self._hold_wanted = False
        self._end_asked = False
        self._finishing = 0  # ticks for which the stand actor is waited for, so that the robot can be lowered
        self._sent: Wish | None = None
        self._blend_from: Wish | None = None
        self._blended = 0

    def request(self, request: Request, state: RobotState | None) -> str | None:
        """Carry out a request, or answer why not."""
        if self.mode not in ALLOWED[request]:
            allowed = ", ".join(mode.name for mode in Mode if mode in ALLOWED[request])
            return f"{request.value} refused in {self.mode.name}, possible in {allowed}"
        self._end_asked = request is Request.FINISH or (self._end_asked and request is Request.LOWER)
        self.lowered = self.lowered and self._end_asked
        match request:
            case Request.DAMP:
                self._damp(latched=True)
            case Request.LOWER | Request.FINISH if self.mode is Mode.BRACING or self._begin_lowering():
                pass
            case Request.FINISH if self._lowering is not None and self.mode in (Mode.TRACKING, Mode.HOLD):
                self._wait_for_standing(self._lowering.wait_ticks)
            case Request.LOWER | Request.FINISH | Request.QUIT:
                # Idle, nothing is in force that would have to end; the loop damps what it has driven before.
                if self.mode is not Mode.IDLE:
                    self._damp(latched=True)
            case Request.ACKNOWLEDGE:
                self._patience = self._acknowledge_ticks if self.latched else 0
            case Request.STAND:
                return self._stand_asked(state)
            case Request.START:
                return self._start_selected(state)
            case Request.HOLD:
                return self._ask_hold()
            case Request.SWITCH:
                self.selected = (self.selected + 1) % len(self.tracked)
        return None

    def trip(self, fault: Fault) -> None:
        """A fault: latched. The first one stays the reason, until it has been acknowledged in vain."""
        if self._patience:
            self._patience -= 1
            self.fault = self.fault if self._patience else fault
            return
        if not (self.latched and self.fault):
            self.fault = fault
        if self.mode is Mode.IDLE:
            self.latched = True
        elif self._bracing is not None and self.mode in BALANCED and fault.rule in FALLING:
            self._bracing.start()
            self._stop(Mode.BRACING, latched=True)
        else:
            self._damp(latched=True)

    @property
    def acknowledging(self) -> bool:
        """Whether the devices' answer to an acknowledgement is waited for."""
        return self._patience > 0

    @property
    def can_lower(self) -> bool:
        """Whether the stand actor balances a robot for which there is a way down."""
        return self._lowering is not None and self.mode in STANDING and self.active is self._stand

    @property
    def finishing(self) -> bool:
        """Whether an end in order waits for the stand actor to take over."""
        return self._finishing > 0

    def no_fault(self) -> None:
        """A tick without any fault: what was acknowledged is over."""
        if self._patience:
            self.mode, self.latched, self.fault, self._patience = Mode.IDLE, False, None, 0

    def start_tracking(self) -> None:
        """Begin in TRACKING at once: a simulated robot was put at the clip's first frame."""
        self._activate(self.tracked[self.selected], Mode.TRACKING)
        self._blend_from = None

    def advance(self, state: RobotState, lap: Callable[[str], None] | None = None) -> Wish | Fault | None:
        """One tick: move on where the present state has ended, then ask what moves the joints. None = nothing does."""
        fault = self._move_on(state)
        self.output = None
        if fault is not None:
            return fault
        if self.mode in RISING and self._stand_up is not None:
            return self._stand_up.fault(state) or self._stand_up.wish()
        if self.mode is Mode.LOWERING and self._lowering is not None:
            return self._lowering.wish(state)
        if self.mode is Mode.BRACING and self._bracing is not None:
            return self._bracing.wish(state)
        if self.active is None:
            return None
        self.output = self.active.act(state, lap)
        return self._blend(Wish(self.output.target_rad, self.output.kp, self.output.kd))

    def sent(self, command: JointCommand) -> None:
        """What became of the wish: where the next actor's blending begins."""
        self._sent = Wish(command.q_rad, command.kp, command.kd)

    def _move_on(self, state: RobotState) -> Fault | None:
        stand, active = self._stand, self.active
        if self.mode is Mode.DAMPING and not self.latched and self._stand_up is not None:
            if fault := self._settling.fault(state):
                return fault
            if self._settling.done:
                self._stand_up.start(state)
                self.mode = Mode.STAND_UP
        elif self.mode is Mode.STAND_UP and stand and self._stand_up and self._stand_up.done:
            if self._fixed_stand:
                self.mode = Mode.FIXED_STAND
            elif stand.obstacle(state) is None:
                self._activate(stand, Mode.READY)
        elif self.mode is Mode.TRACKING and active:
            if active.finished:
                self._end_of_clip(state)
            elif (self._hold_wanted or active.resting) and stand and stand.obstacle(state) is None:
                self._activate(stand, Mode.HOLD)
        elif self.mode is Mode.LOWERING and self._lowering:
            if (lost := self._lowering.lost(state)) or self._lowering.done:
                self._damp(latched=True)
                self.lowered = self._end_asked and not lost
        elif self.mode is Mode.BRACING and self._bracing and self._bracing.done:
            self._damp(latched=True)
        elif self.mode is Mode.HOLD and stand and active is not stand and stand.obstacle(state) is None:
            self._activate(stand, Mode.HOLD)
        if self._finishing:
            self._finishing -= 1
            if not self._begin_lowering() and not self._finishing:
                self._damp(latched=True)
        return None

    def _end_of_clip(self, state: RobotState) -> None:
        if self._stand is None:
            self._damp(latched=False)
        elif self._stand.obstacle(state) is None:
            self._activate(self._stand, Mode.HOLD)
        else:
            self.mode = Mode.HOLD

    def _activate(self, actor: ActorRun, mode: Mode) -> None:
        actor.start()
        self.active, self.mode = actor, mode
        self._blend_from, self._blended = self._sent, 0
        self._hold_wanted = False

    def _blend(self, wish: Wish) -> Wish:
        """From what was last sent, safety's limits included, when the actor took over, to its own targets and gains."""
        before = self._blend_from
        if before is None:
            return wish
        self._blended += 1
        if self._blended >= self._blend_ticks:
            self._blend_from = None
            return wish
        share = self._blended / self._blend_ticks
        return Wish(
            before.target_rad + share * (wish.target_rad - before.target_rad),
            before.kp + share * (wish.kp - before.kp),
            before.kd + share * (wish.kd - before.kd),
        )

    def _stand_asked(self, state: RobotState | None) -> str | None:
        if self._stand is None:
            return "stand refused: there is no stand actor"
        if self.latched:
            return f"stand refused: {self.fault}; acknowledge it first"
        if self.mode is Mode.IDLE:
            self._damp(latched=False)
            return None
        if why := "no state" if state is None else self._stand.obstacle(state):
            return f"balancing refused: {why}"
        self._activate(self._stand, Mode.READY)
        return None

    def _begin_lowering(self) -> bool:
        """Lower a robot that the stand actor balances. False where it does not: there is no time then."""
        if self.mode is Mode.LOWERING:
            return True
        if self._lowering is None or not self.can_lower:
            return False
        self._lowering.start(self._sent)
        self.mode, self.active, self._blend_from, self._finishing = Mode.LOWERING, None, None, 0
        return True

    def _wait_for_standing(self, ticks: int) -> None:
        """Inside a motion: let the stand actor take over as soon as it can."""
        if not self._finishing:
            self._finishing = ticks
            self._ask_hold()

    def _start_selected(self, state: RobotState | None) -> str | None:
        if self._finishing:
            return "start refused: the robot is about to be lowered"
        actor = self.tracked[self.selected]
        why = "no state" if state is None else actor.obstacle(state)
        if why is not None:
            return f"start refused: {why}"
        self._activate(actor, Mode.TRACKING)
        return None

    def _ask_hold(self) -> str | None:
        if self._stand is None:
            return "hold refused: there is no stand actor"
        self._hold_wanted = True
        if self.active is not None:
            self.active.give_way()
        return None

    def _damp(self, *, latched: bool) -> None:
        self._stop(Mode.DAMPING, latched=latched)
        self._settling.start()

    def _stop(self, mode: Mode, *, latched: bool) -> None:
        """No actor moves the joints any more."""
        self.mode, self.latched, self._patience, self._finishing = mode, self.latched or latched, 0, 0
        self.active = self._sent = self._blend_from = None
