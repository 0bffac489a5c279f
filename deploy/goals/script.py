"""A goal from a file: speeds for some seconds each, ways along points on the ground, and clips in between."""

import hashlib
import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from core.config import errors_in, load_options
from core.errors import InputError
from core.rotations import yaw_of
from core.structured import positive, within
from deploy.goals.clip import ClipGoal
from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.option import SHOWN, WHOLE
from deploy.goals.points import PointGuard
from deploy.goals.settings import GoalSettings
from deploy.goals.source import Goal
from deploy.goals.steering import SteeredRows
from deploy.goals.way import AT_REST, Way, directions_rad, lengths_m
from deploy.safety.rules import Asked
from motion.clip import Clip
from motion.reference import Reference
from motion.steering import AXES

SHORTEST_REST_S = 1.0
SHORTEST_M = 0.2  # way from one point to the next
LONGEST_S = 3600.0


@dataclass(frozen=True)
class Step:
    """One entry: ``for_s`` seconds at these speeds in m/s and rad/s, a ``path``, or a ``clip``, shown as ``kind``.

    ``reach``: with ``for_s``, where the right hand shall be meanwhile: ahead, to the left and above the floor, from
    below the root, m. ``path``: points ahead and to the left of where the entry begins, m, at ``speed``, m/s, looking
    ``heading`` rad to the left of where it looks at first, or, without one, along the way.
    """

    for_s: float | None = None
    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    reach: tuple[float, float, float] | None = None
    path: tuple[tuple[float, float], ...] | None = None
    speed: float | None = None
    heading: float | None = None
    clip: str | None = None
    kind: str = WHOLE

    def __post_init__(self) -> None:
        named = [name for name in ("for_s", "path", "clip") if getattr(self, name) is not None]
        if len(named) != 1:
            got = " and ".join(named) or "none of them"
            raise InputError("not one thing to do", got=got, expected="for_s with speeds, path with speed, or clip")
        if self.for_s is not None:
            positive("for_s", self.for_s)
        elif any(self.speeds) or self.reach is not None:
            hint = "make them an entry of their own"
            raise InputError(f"speeds or reach beside a {named[0]}", got=[*self.speeds, self.reach], hint=hint)
        if self.path is not None:
            self._check_path(self.path)
        elif self.speed is not None or self.heading is not None:
            got = f"speed {self.speed}, heading {self.heading}"
            raise InputError("no path that they belong to", got=got, expected="path")
        self._check_kind()

    @property
    def speeds(self) -> tuple[float, float, float]:
        """Forward, left, turn."""
        return self.forward, self.left, self.turn

    def _check_kind(self) -> None:
        if self.kind not in SHOWN:
            raise InputError("no such kind of goal", where="kind", got=self.kind, expected=f"one of {', '.join(SHOWN)}")
        if self.clip is None and self.kind != WHOLE:
            raise InputError("no clip that it belongs to", where="kind", got=self.kind, expected="clip")

    def _check_path(self, path: tuple[tuple[float, float], ...]) -> None:
        if not path:
            raise InputError("no point", where="path", expected="one or more, each [ahead, to the left] in m")
        if self.speed is None:
            raise InputError("missing key", where="speed", expected="m/s, beside path")
        positive("speed", self.speed)
        lengths = lengths_m(np.array(path))
        for number, length in enumerate(lengths):
            if not length >= SHORTEST_M:
                expected = f"at least {SHORTEST_M} m from the point before"
                raise InputError("too near", where=f"path[{number}]", got=f"{length:.3g} m", expected=expected)
        if not lengths.sum() <= LONGEST_S * self.speed:
            got, expected = f"{lengths.sum() / self.speed:.3g} s at its speed", f"at most {LONGEST_S:g} s"
            raise InputError("too long", where="path", got=got, expected=expected)


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
            _check_ranges(step, settings, f"steps[{number}]")
            last = number + 1 == len(script.steps)
            if _leaves_rest(step) or not (last or script.steps[number + 1].clip is not None):
                continue
            hint = f"put {{for_s: {SHORTEST_REST_S}}} after it: clips begin at rest, and so does the end"
            raise InputError("not at rest before what follows", where=f"steps[{number}]", hint=hint)
    return script


def _check_ranges(step: Step, settings: GoalSettings, where: str) -> None:
    """Speeds, also those that a path asks for, and the hand's place are ones that the guard lets through."""
    for name, speed, axis in zip(AXES, step.speeds, settings.axes, strict=True):
        within(f"{where}.{name}", speed, axis.low, axis.high)
    if step.reach is not None:
        bounds = settings.points.right_hand
        for index, (value, low, high) in enumerate(zip(step.reach, bounds.low, bounds.high, strict=True)):
            within(f"{where}.reach[{index}]", value, low, high)
    if step.path is None or step.speed is None:
        return
    if step.heading is None:
        within(f"{where}.speed", step.speed, 0.0, settings.forward.high)
        if not settings.turn.low < 0.0 < settings.turn.high:
            got, hint = [settings.turn.low, settings.turn.high], "put a heading beside it"
            raise InputError("the robot may not turn along it", where=f"{where}.path", got=got, hint=hint)
        return
    for number, direction in enumerate(directions_rad(np.array(step.path)) - step.heading):
        parts = (step.speed * math.cos(direction), step.speed * math.sin(direction))
        for name, speed, axis in zip(AXES, parts, settings.axes):
            within(f"{where}.path[{number}]: speed {name}", round(speed, 6), axis.low, axis.high)


def _leaves_rest(step: Step) -> bool:
    """Whether the robot rests at its end: clips end at rest."""
    if step.clip is not None:
        return True
    still = not any(step.speeds) and step.reach is None
    return step.for_s is not None and step.for_s >= SHORTEST_REST_S and still


class ScriptGoal:
    """A GoalSource that does one entry after another, once, behind a guard.

    clips: those of the entries that are clips, in their order. A clip begins with the heading that is asked for then,
    and leaves its own to what follows. The robot begins in the first pose of ``standing``. settings, points: of guard.
    """

    reference: Reference | None = None
    clip: Clip | None = None
    resting = False

    def __init__(
        self, name: str, script: Script, clips: list[ClipGoal], standing: Reference, settings: GoalSettings,
        guard: GoalGuard, points: PointGuard,
    ) -> None:  # fmt: skip
        self.name, self.setting = name, standing
        content = [asdict(step) for step in script.steps] + [clip.sha256 for clip in clips]
        self.sha256 = hashlib.sha256(json.dumps(content).encode()).hexdigest()
        self.start_pose_rad = standing.joint_pos_rad[0]
        self._guard, self._rows = guard, SteeredRows(standing, points)
        given = iter(clips)
        self._steps: list[ClipGoal | Way | _Timed] = [
            next(given) if step.clip is not None else self._steered(step, settings) for step in script.steps
        ]
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
        self._rows.start()
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
            asked, leaves = NOBODY if self._gives_way else step.next(), self._gives_way or self.finished
            return self._rows.next(self._guard, asked, yaw_rad, leaves=leaves)
        self._guard.see(yaw_rad)
        return replace(step.next(yaw_rad), turn_rad=self._turn_rad)

    def _steered(self, step: Step, settings: GoalSettings) -> "Way | _Timed":
        period_s = self.setting.dt_s
        if step.path is None or step.speed is None:
            return _Timed(step, period_s)
        return Way(np.array(step.path), step.speed, step.heading, settings, self._guard, period_s)

    def _begin(self, number: int) -> None:
        """Lay a clip so that it begins with the heading that is asked for."""
        self._number, self._step = number, self._steps[number]
        self._step.start()
        self._turn_rad = 0.0
        if isinstance(self._step, ClipGoal):
            self._turn_rad = self._guard.heading_rad - _heading_rad(self._step.setting, 0)


class _Timed:
    """Speeds for some ticks, and perhaps a place of the hand, then rest."""

    def __init__(self, step: Step, dt_s: float) -> None:
        assert step.for_s is not None
        self._steer = Steer(*step.speeds, points=step.reach or ())
        self._ticks = max(1, round(step.for_s / dt_s))
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
