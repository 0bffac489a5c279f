"""A goal from a file: speeds for some seconds each, and clips in between."""

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from core.config import errors_in, load_options
from core.errors import InputError
from core.rotations import yaw_of
from core.structured import positive, within
from deploy.goals.clip import ClipGoal
from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.source import Goal
from deploy.goals.steering import SteeredRows
from deploy.safety.rules import Asked
from deploy.settings import GoalSettings
from motion.clip import Clip
from motion.reference import Reference
from policy.goals import visible_in

AT_REST = Steer(0.0, 0.0, 0.0)
SHORTEST_REST_S = 1.0


@dataclass(frozen=True)
class Step:
    """One entry: either ``for_s`` seconds at these speeds in m/s and rad/s, or a ``clip``, shown as ``kind``."""

    for_s: float | None = None
    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    clip: str | None = None
    kind: str = "full"

    def __post_init__(self) -> None:
        if (self.for_s is None) == (self.clip is None):
            got = "neither" if self.clip is None else "both"
            raise InputError("not one thing to do", got=got, expected="either for_s with speeds, or clip")
        if self.for_s is not None:
            positive("for_s", self.for_s)
        if self.clip is not None and any(self.speeds):
            raise InputError("speeds beside a clip", got=list(self.speeds), hint="make them an entry of their own")
        visible_in(self.kind)

    @property
    def speeds(self) -> tuple[float, float, float]:
        """Forward, left, turn."""
        return self.forward, self.left, self.turn


@dataclass(frozen=True)
class Script:
    """The document."""

    steps: tuple[Step, ...]

    def __post_init__(self) -> None:
        if not self.steps:
            raise InputError("nothing to do", where="steps", expected="one entry or more")


def load_script(path: Path, settings: GoalSettings) -> Script:
    """Read and check a file. Raises InputError naming file and entry: what is unknown, out of range, or too sudden."""
    script = load_options(Script, path)
    with errors_in(path):
        for number, step in enumerate(script.steps):
            for name, speed, axis in zip(("forward", "left", "turn"), step.speeds, settings.axes, strict=True):
                within(f"steps[{number}].{name}", speed, axis.low, axis.high)
            last = number + 1 == len(script.steps)
            if _leaves_rest(step) or not (last or script.steps[number + 1].clip is not None):
                continue
            hint = f"put {{for_s: {SHORTEST_REST_S}}} after it: clips begin at rest, and so does the end"
            raise InputError("not at rest before what follows", where=f"steps[{number}]", hint=hint)
    return script


def _leaves_rest(step: Step) -> bool:
    """Whether the robot rests at its end: clips end at rest."""
    return step.for_s is None or (step.for_s >= SHORTEST_REST_S and not any(step.speeds))


class ScriptGoal:
    """A GoalSource that does one entry after another, once, behind a guard.

    clips: those of the entries that are clips, in their order. A clip begins with the heading that is asked for then,
    and leaves its own to what follows. The robot begins in the first pose of ``standing``.
    """

    reference: Reference | None = None
    clip: Clip | None = None
    resting = False

    def __init__(self, name: str, script: Script, clips: list[ClipGoal], standing: Reference, guard: GoalGuard) -> None:
        self.name, self.setting = name, standing
        content = [asdict(step) for step in script.steps] + [clip.sha256 for clip in clips]
        self.sha256 = hashlib.sha256(json.dumps(content).encode()).hexdigest()
        self.start_pose_rad = standing.joint_pos_rad[0]
        given = iter(clips)
        self._steps = [_Timed(step, standing.dt_s) if step.clip is None else next(given) for step in script.steps]
        self._guard, self._rows = guard, SteeredRows(standing)
        self.start()

    @property
    def finished(self) -> bool:
        """Whether the last entry is over; it goes on at rest."""
        last = self._gives_way or self._number + 1 == len(self._steps)
        return self._guard.lost or (self._step.finished and last)

    @property
    def asked(self) -> Asked | None:
        """See GoalSource."""
        return self._step.asked if isinstance(self._step, ClipGoal) else None

    def start(self) -> None:
        """See GoalSource."""
        self._guard.start()
        self._gives_way = False
        self._begin(0)

    def give_way(self) -> None:
        """See GoalSource: a clip that plays goes on, and nothing follows it."""
        self._gives_way = True

    def next(self, yaw_rad: float) -> Goal:
        """See GoalSource."""
        step = self._step
        if step.finished and not self.finished and not self._gives_way:
            if isinstance(step, ClipGoal):
                self._guard.heading_rad = self._turn_rad + _heading_rad(step.setting, -1)
            self._begin(self._number + 1)
            step = self._step
        if not isinstance(step, ClipGoal):
            return self._rows.next(self._guard, NOBODY if self._gives_way else step.next(), yaw_rad)
        self._guard.see(yaw_rad)
        return replace(step.next(yaw_rad), turn_rad=self._turn_rad)

    def _begin(self, number: int) -> None:
        """Lay a clip so that it begins with the heading that is asked for."""
        self._number, self._step = number, self._steps[number]
        self._step.start()
        self._turn_rad = 0.0
        if isinstance(self._step, ClipGoal):
            self._turn_rad = self._guard.heading_rad - _heading_rad(self._step.setting, 0)


class _Timed:
    """Speeds for some ticks, then rest."""

    def __init__(self, step: Step, dt_s: float) -> None:
        assert step.for_s is not None
        self._steer, self._ticks = Steer(*step.speeds), max(1, round(step.for_s / dt_s))
        self._left = self._ticks

    @property
    def finished(self) -> bool:
        """Whether its time is over."""
        return self._left == 0

    def start(self) -> None:
        """Its time begins."""
        self._left = self._ticks

    def next(self) -> Steer:
        """One tick."""
        if self.finished:
            return AT_REST
        self._left -= 1
        return self._steer


def _heading_rad(reference: Reference, row: int) -> float:
    return float(yaw_of(np.asarray(reference.root_quat_wxyz[row])))
