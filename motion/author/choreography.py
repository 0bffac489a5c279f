"""The choreography file: key poses by body targets and timing, read into knots per group of channels.

`fps`, then `keys` (or `walk`, see :mod:`motion.author.walking`), each `at_s` with a free text `pose` and any of these
groups; a part not given keeps its last value:

- `pelvis`: sink_m below the stand pose; yaw_rad, pitch_rad, roll_rad in the world.
- `torso`: yaw_rad, roll_rad, pitch_rad against the pelvis.
- `balance`: left = share of the weight on the left foot (where the pressure point lies between the soles);
  forward_m along the pelvis' heading.
- `left_foot`, `right_foot`: x_m, y_m, z_m, yaw_rad, pitch_rad, roll_rad against the foot's place in the stand pose.
  A foot with z_m 0 at two keys in a row stays, or steps with `arc_m`, the height of the step.
- `left_arm`, `right_arm`: hand_m [x, y, z] in the torso frame; swivel_rad turns the elbow outwards from down and back.
  `arms` sets the left one and mirrors it.
- `hold`: groups that rest where they are; `stand`: groups that go back to the stand pose; also all, arms, feet.

A group moves smoothly through the keys that name it and rests where two of them in a row are equal.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from core.config import errors_in, read_yaml
from core.errors import InputError
from core.structured import check_keys, parse, within
from motion.author.walking import Walk, walk_keys

FOOT = ("x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad")
ARM = ("x_m", "y_m", "z_m", "swivel_rad")
GROUPS: dict[str, tuple[str, ...]] = {
    "pelvis": ("sink_m", "yaw_rad", "pitch_rad", "roll_rad"),
    "torso": ("yaw_rad", "roll_rad", "pitch_rad"),
    "balance": ("left", "forward_m"),
    "left_foot": FOOT,
    "right_foot": FOOT,
    "left_arm": ARM,
    "right_arm": ARM,
}
PLACE = ("pelvis", "left_foot", "right_foot")
KEY_FIELDS = ("at_s", "pose", "hold", "stand", "arms", *GROUPS)


@dataclass(frozen=True)
class Knot:
    """One channel group at one time: `values` in the order of GROUPS; `arc_m` only for a foot that steps here."""

    at_s: float
    key: int
    values: tuple[float, ...]
    arc_m: float = 0.0


@dataclass(frozen=True)
class Choreography:
    """fps, times of the keys and, per group, the knots of each of its channels (values None where not given)."""

    path: Path
    fps: float
    key_times_s: tuple[float, ...]
    key_poses: tuple[str, ...]
    knots: dict[str, list[Knot]] = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the clip."""
        return self.path.stem

    def where(self, key: int) -> str:
        """How errors name a key."""
        pose = f", {self.key_poses[key]}" if self.key_poses[key] else ""
        return f"{self.path}: keys[{key}] (at {self.key_times_s[key]:g} s{pose})"

    def key_at(self, time_s: float) -> int:
        """The key that the motion heads for at `time_s`."""
        return next((i for i, t in enumerate(self.key_times_s) if t >= time_s - 1e-9), len(self.key_times_s) - 1)


def load_choreography(
    path: Path,
    stand: Mapping[str, tuple[float, ...]],
    feet_m: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> Choreography:
    """Choreography of the YAML file at `path`; `stand` gives every group's values in the stand pose.

    `feet_m`: where the feet stand there, by side; needed by a file that says `walk` (:mod:`motion.author.walking`)
    instead of `keys`.
    Raises InputError naming file and key.
    """
    table = read_yaml(path)
    with errors_in(path):
        walks = "walk" in table
        check_keys(table, ("fps", "walk" if walks else "keys"), "")
        fps = parse(float, table["fps"], "fps")
        within("fps", fps, 1.0, 1000.0)
        if walks:
            hands_m = {side: stand[f"{side}_arm"][:3] for side in feet_m}
            keys = walk_keys(parse(Walk, table["walk"], "walk"), feet_m, hands_m)
        else:
            keys = table["keys"]
        if not isinstance(keys, list) or len(keys) < 2:
            raise InputError("wrong value", where="keys", got=keys, expected="a list of two or more key poses")
        for i, key in enumerate(keys):
            check_keys(key, KEY_FIELDS, f"keys[{i}]", optional=KEY_FIELDS[1:])
    times = _checked_times(keys, path, fps)
    poses = tuple(str(key.get("pose", "")) for key in keys)
    knots = {group: [Knot(0.0, 0, stand[group])] for group in GROUPS}
    for i, key in enumerate(keys):
        where = f"{path}: keys[{i}] (at {times[i]:g} s)"
        for group, values, arc_m in _entries(key, knots, stand, where):
            if times[i] > 0.0:
                knots[group].append(Knot(times[i], i, values, arc_m))
    _check_end(knots, stand, times[-1], path, PLACE if walks else ())
    return Choreography(path, fps, times, poses, knots)


def _number(value: Any, where: str) -> float:
    number = parse(float, value, where)
    within(where, number, -1e6, 1e6)
    return number


def _checked_times(keys: list[dict[str, Any]], path: Path, fps: float) -> tuple[float, ...]:
    times = tuple(_number(key["at_s"], f"{path}: keys[{i}].at_s") for i, key in enumerate(keys))
    if times[0] != 0.0:
        raise InputError("wrong time", where=f"{path}: keys[0].at_s", got=times[0], expected="0")
    for i in range(1, len(times)):
        if times[i] <= times[i - 1]:
            where = f"{path}: keys[{i}].at_s"
            raise InputError("times do not increase", where=where, got=times[i], expected=f"more than {times[i - 1]:g}")
    if abs(times[-1] * fps - round(times[-1] * fps)) > 1e-6:
        where, expected = f"{path}: keys[{len(times) - 1}].at_s", f"a whole number of frames at {fps:g} fps"
        raise InputError("wrong time", where=where, got=times[-1], expected=expected)
    return times


def _entries(
    key: Mapping[str, Any], knots: Mapping[str, list[Knot]], stand: Mapping[str, tuple[float, ...]], where: str
) -> Iterator[tuple[str, tuple[float, ...], float]]:
    """(group, values, arc) of every group that this key sets; a part not given keeps its last value."""
    given: dict[str, Any] = {group: key[group] for group in GROUPS if group in key}
    if "arms" in key:
        given |= {"left_arm": key["arms"], "right_arm": _mirrored(key["arms"], f"{where}.arms")}
    held, stood = _groups(key.get("hold", []), f"{where}.hold"), _groups(key.get("stand", []), f"{where}.stand")
    if "arms" in key and ("left_arm" in key or "right_arm" in key):
        raise InputError("set twice", where=where, got="arms beside left_arm or right_arm", expected="one of them")
    for group in GROUPS:
        last = knots[group][-1].values
        if group in given:
            yield group, *_values(group, given[group], last, f"{where}.{group}")
        elif group in stood:
            yield group, stand[group], 0.0
        elif group in held:
            yield group, last, 0.0


def _groups(names: Any, where: str) -> tuple[str, ...]:
    """Names of the groups that `hold` or `stand` lists; `all` and `arms` stand for several."""
    names = [names] if isinstance(names, str) else names
    several = {"all": tuple(GROUPS), "arms": ("left_arm", "right_arm"), "feet": ("left_foot", "right_foot")}
    if not isinstance(names, list) or any(name not in GROUPS and name not in several for name in names):
        raise InputError("unknown body", where=where, got=names, expected=", ".join((*several, *GROUPS)))
    return tuple(group for name in names for group in several.get(name, (name,)))


def _values(group: str, table: Any, last: tuple[float, ...], where: str) -> tuple[tuple[float, ...], float]:
    """Values of `group` after `table`, and the step's arc."""
    if not isinstance(table, dict):
        raise InputError("wrong value", where=where, got=table, expected=f"a table of {', '.join(GROUPS[group])}")
    table = dict(table)
    if group.endswith("_arm") and "hand_m" in table:
        hand = table.pop("hand_m")
        if not isinstance(hand, list) or len(hand) != 3:
            raise InputError("wrong value", where=f"{where}.hand_m", got=hand, expected="[x, y, z] in the torso frame")
        table |= dict(zip(ARM, hand, strict=False))
    arc_m = _number(table.pop("arc_m", 0.0), f"{where}.arc_m") if group.endswith("_foot") else 0.0
    check_keys(table, GROUPS[group], where, optional=GROUPS[group])
    numbers = {name: _number(value, f"{where}.{name}") for name, value in table.items()}
    return tuple(numbers.get(name, old) for name, old in zip(GROUPS[group], last, strict=True)), arc_m


def _mirrored(arm: Any, where: str) -> Any:
    """The right arm of a left arm's entry."""
    if not isinstance(arm, dict) or not isinstance(arm.get("hand_m", [0, 0, 0]), list):
        raise InputError("wrong value", where=where, got=arm, expected="hand_m: [x, y, z] and swivel_rad")
    flipped = dict(arm)
    if len(arm.get("hand_m", [])) == 3:
        x, y, z = arm["hand_m"]
        flipped["hand_m"] = [x, -_number(y, f"{where}.hand_m"), z]
    return flipped


def _check_end(
    knots: Mapping[str, list[Knot]],
    stand: Mapping[str, tuple[float, ...]],
    end_s: float,
    path: Path,
    elsewhere: Sequence[str],
) -> None:
    """InputError unless every group ends as it stands; those that say where on the ground may end ``elsewhere``."""
    away = [g for g, k in knots.items() if k[-1].values != stand[g] and g not in elsewhere]
    if away:
        expected = "the stand pose: the last key says `stand: all`"
        raise InputError("does not end in the stand pose", where=path, got=", ".join(away), expected=expected)
    for group_knots in knots.values():
        if group_knots[-1].at_s < end_s:
            group_knots.append(Knot(end_s, group_knots[-1].key, group_knots[-1].values))
