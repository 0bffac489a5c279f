"""Where a run's time went, from the keys under time/."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

_CLOCKED = ("collect", "learn", "evaluate")
_WITHIN_COLLECTING = (
    ("the actor acts", "time/act_s"),
    ("the environment steps", "time/step_s"),
)


@dataclass(frozen=True)
class Part:
    """Seconds of the whole run; ``within`` another part they are counted there already."""

    name: str
    seconds: float
    within: bool = False

    @property
    def title(self) -> str:
        """The name for people."""
        return f"of which: {self.name}" if self.within else self.name


def time_split(rows: Sequence[Mapping[str, Any]]) -> list[Part]:
    """What the time of all rows was spent on, saving included, which the run's own clock leaves out.

    Preparing is what the clock says of the first row beyond its parts: building environments and networks.
    """
    if not rows:
        return []
    collect, learn, judge, save = (_sum(rows, f"time/{name}_s") for name in (*_CLOCKED, "save"))
    inner = [Part(name, _sum(rows, key), within=True) for name, key in _WITHIN_COLLECTING]
    prepare = _beyond_parts(rows[:1], float(rows[0].get("time/wall_s") or 0.0))
    rest = _beyond_parts(rows, float(rows[-1].get("time/wall_s") or 0.0) - prepare)
    return [
        Part("preparing", prepare),
        Part("collecting", collect),
        *(part for part in inner if part.seconds > 0.0),
        Part("learning", learn),
        Part("evaluating", judge),
        Part("saving: checkpoints, curves, report", save),
        Part("everything else", rest),
    ]


def total_s(parts: Sequence[Part]) -> float:
    """Seconds of all parts that are not within another."""
    return sum(part.seconds for part in parts if not part.within)


def _beyond_parts(rows: Sequence[Mapping[str, Any]], wall_s: float) -> float:
    return max(0.0, wall_s - sum(_sum(rows, f"time/{name}_s") for name in _CLOCKED))


def _sum(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    return float(sum(row.get(key) or 0.0 for row in rows))
