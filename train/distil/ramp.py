"""A number that follows the iterations."""

from dataclasses import dataclass

from core.errors import InputError
from core.structured import at_least


@dataclass(frozen=True)
class Ramp:
    """``first`` until the iteration ``begin``, then linearly to ``last``, which it is from ``end`` on.

    Without ``last`` it stays.
    """

    first: float
    last: float | None = None
    begin: int = 0
    end: int = 0

    def __post_init__(self) -> None:
        for name in ("first", "begin", "end"):
            at_least(name, getattr(self, name), 0)
        if self.last is not None:
            at_least("last", self.last, 0)
        if self.end < self.begin:
            raise InputError("before begin", where="end", got=self.end, expected=f"{self.begin} or later")

    def at(self, iteration: int) -> float:
        """The number at an iteration, counted from 0."""
        if self.last is None or iteration < self.begin:
            return self.first
        if iteration >= self.end:
            return self.last
        return self.first + (self.last - self.first) * (iteration - self.begin) / (self.end - self.begin)
