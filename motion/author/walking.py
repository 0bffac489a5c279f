"""Walks: from speeds to the key poses of a choreography, step by step.

The file's `walk` stands in the place of `keys`. Each entry of `walk.parts` lasts `for_s` with the speeds `forward_m_s`,
`left_m_s` and `turn_rad_s`, all 0 for standing. Speeds change by at most `ramp` of full speed a step. A foot lands
where the walker's place will be in the middle of its stance; the weight goes over while both feet are down.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from core.errors import InputError
from core.structured import at_least, positive, within

SIDES = ("left", "right")
REST = ["feet", "balance", "arms", "torso"]
BEGIN_S, SINK_S, END_S = 0.4, 0.6, 0.8
ON_LEFT = {"left": 0.95, "right": 0.05}  # share of the weight on the left foot while a foot bears it


@dataclass(frozen=True)
class Part:
    """Speeds that are kept for some time."""

    for_s: float
    forward_m_s: float = 0.0
    left_m_s: float = 0.0
    turn_rad_s: float = 0.0

    def __post_init__(self) -> None:
        positive("for_s", self.for_s)
        within("forward_m_s", self.forward_m_s, -1.0, 1.5)
        within("left_m_s", self.left_m_s, -0.5, 0.5)
        within("turn_rad_s", self.turn_rad_s, -2.0, 2.0)

    @property
    def speeds(self) -> tuple[float, float, float]:
        """Forwards, to the left (m/s), turning to the left (rad/s)."""
        return self.forward_m_s, self.left_m_s, self.turn_rad_s


@dataclass(frozen=True)
class Walk:
    """How to walk. Times in s, lengths in m.

    step_s: from one landing to the next; double_s: of it, with both feet down. arc_m: how high a foot swings. sink_m:
    how far below the stand pose the pelvis stays. swing_m: of the hands, at 1 m/s. ramp: largest change of a speed from
    one step to the next, in m/s, m/s and rad/s.
    """

    parts: tuple[Part, ...]
    step_s: float = 0.4
    double_s: float = 0.1
    arc_m: float = 0.05
    sink_m: float = 0.06
    swing_m: float = 0.1
    ramp: tuple[float, float, float] = (0.2, 0.1, 0.4)

    def __post_init__(self) -> None:
        if not self.parts:
            raise InputError("no part", where="walk.parts", expected="one or more")
        within("walk.double_s", self.double_s, 0.04, self.step_s - 0.2)
        for name in ("arc_m", "sink_m", "swing_m"):
            at_least(f"walk.{name}", getattr(self, name), 0.0)
        for limit in self.ramp:
            positive("walk.ramp", limit)


Place = tuple[float, float]
Pose = tuple[float, float, float]
"""Place on the ground (m) and heading (rad)."""


def walk_keys(walk: Walk, feet_m: Mapping[str, Place], hands_m: Mapping[str, Sequence[float]]) -> list[dict[str, Any]]:
    """The keys of a choreography that begins and ends in the stand pose.

    feet_m, hands_m: by side, where the stand pose has the feet on the ground and the hands in the torso frame.
    """
    keys: list[dict[str, Any]] = [{"at_s": 0.0, "pose": "stand"}, {"at_s": BEGIN_S, "hold": ["all"]}]
    at_s, pose = BEGIN_S + SINK_S, (0.0, 0.0, 0.0)
    keys.append({"at_s": at_s, "pose": "knees bent", "pelvis": {"sink_m": walk.sink_m}, "hold": REST})
    for standing, speeds in _stretches(walk):
        if standing:
            at_s += standing
            keys.append({"at_s": at_s, "pose": "standing", "hold": ["all"]})
            continue
        steps, pose = _steps(walk, speeds, pose)
        keys += _stretch_keys(walk, steps, at_s, feet_m, hands_m)
        at_s = keys[-1]["at_s"]
    return _rounded([*keys, *_ending(at_s)])


@dataclass(frozen=True)
class Step:
    """One step: which foot swings, where it lands, the walker's heading then, and its speed forwards."""

    side: str
    lands: Pose
    heading_rad: float
    forward_m_s: float


def _stretches(walk: Walk) -> Iterator[tuple[float, list[Pose]]]:
    """Standing for some time, or the speeds of steps that begin and end at rest."""
    wanted: list[tuple[float, float, float]] = []
    for part in walk.parts:
        if any(part.speeds):
            wanted += [part.speeds] * max(1, round(part.for_s / walk.step_s))
            continue
        if wanted:
            yield 0.0, _ramped(wanted, walk.ramp)
        wanted = []
        yield part.for_s, []
    if wanted:
        yield 0.0, _ramped(wanted, walk.ramp)


def _ramped(wanted: list[Pose], ramp: Pose) -> list[Pose]:
    """The speeds of each step, no two further apart than ``ramp``, then rest: two steps bring the feet together."""
    found: list[Pose] = []
    now: Pose = (0.0, 0.0, 0.0)
    for goal in wanted:
        now = _towards(now, goal, ramp)
        found.append(now)
    while any(now):
        now = _towards(now, (0.0, 0.0, 0.0), ramp)
        found.append(now)
    return [*found, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)]


def _towards(now: Pose, goal: Pose, ramp: Pose) -> Pose:
    x, y, turn = (n + max(-r, min(r, g - n)) for n, g, r in zip(now, goal, ramp, strict=True))
    return x, y, turn


def _steps(walk: Walk, speeds: list[Pose], pose: Pose) -> tuple[list[Step], Pose]:
    """The steps with such speeds from ``pose`` on, and where they end. The foot on the side of the way goes first."""
    _, left, turn = next((s for s in speeds if s[1] or s[2]), (0.0, 1.0, 0.0))
    side, steps = SIDES[(left or turn) < 0.0], []
    for speed, following in pairwise([*speeds, (0.0, 0.0, 0.0)]):
        pose = _moved(pose, speed, walk.step_s)
        steps.append(Step(side, _moved(pose, following, 0.5 * walk.step_s), pose[2], speed[0]))
        side = SIDES[side == "left"]
    return steps, pose


def _moved(pose: Pose, speed: Pose, seconds: float) -> Pose:
    """After so long at a speed, along an arc."""
    x, y, heading = pose
    forward, left, turn = (part * seconds for part in speed)
    middle = heading + 0.5 * turn
    return (
        x + forward * math.cos(middle) - left * math.sin(middle),
        y + forward * math.sin(middle) + left * math.cos(middle),
        heading + turn,
    )


def _stretch_keys(
    walk: Walk,
    steps: list[Step],
    at_s: float,
    feet_m: Mapping[str, Place],
    hands_m: Mapping[str, Sequence[float]],
) -> Iterator[dict[str, Any]]:
    """The weight goes to the first standing foot; then swing, landing, and the weight's way over, step by step."""
    others = {"left": "right", "right": "left"}
    at_s += 2.0 * walk.double_s + 0.1
    yield {
        "at_s": at_s,
        "pose": "weight over",
        "balance": {"left": ON_LEFT[others[steps[0].side]]},
        "hold": ["feet", "arms"],
    }
    for number, step in enumerate(steps):
        at_s += walk.step_s - walk.double_s
        last = number == len(steps) - 1
        swing = math.copysign(walk.swing_m, 1.0 if step.side == "left" else -1.0) * step.forward_m_s
        yield {
            "at_s": at_s,
            "pose": f"step {number + 1}, {step.side}",
            f"{step.side}_foot": {**_placed(step, feet_m[step.side]), "arc_m": walk.arc_m},
            "pelvis": {"yaw_rad": step.heading_rad},
            "left_arm": _hand(hands_m["left"], -swing),
            "right_arm": _hand(hands_m["right"], swing),
            "hold": ["balance", f"{others[step.side]}_foot"],
        }
        at_s += walk.double_s * (2.0 if last else 1.0)
        yield {"at_s": at_s, "balance": {"left": 0.5 if last else ON_LEFT[step.side]}, "hold": ["feet"]}


def _placed(step: Step, stands_m: Place) -> dict[str, float]:
    """A foot's place against the one in the stand pose."""
    (x, y, heading), (ahead, beside) = step.lands, stands_m
    return {
        "x_m": x + ahead * math.cos(heading) - beside * math.sin(heading) - ahead,
        "y_m": y + ahead * math.sin(heading) + beside * math.cos(heading) - beside,
        "yaw_rad": heading,
    }


def _hand(rest_m: Sequence[float], forward_m: float) -> dict[str, Any]:
    x, y, z = rest_m
    return {"hand_m": [x + forward_m, y, z]}


def _ending(at_s: float) -> list[dict[str, Any]]:
    """Up again, where the walk has ended."""
    risen = {"at_s": at_s + SINK_S + 0.2, "pose": "up again", "pelvis": {"sink_m": 0.0}, "hold": REST}
    return [risen, {"at_s": at_s + SINK_S + 0.2 + END_S, "hold": ["all"]}]


def _rounded(keys: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Times in whole hundredths; the last one in whole fifths, which every usual frame rate has."""
    for key in keys:
        key["at_s"] = round(key["at_s"], 2)
    keys[-1]["at_s"] = math.ceil(keys[-1]["at_s"] * 5.0) / 5.0
    return keys
