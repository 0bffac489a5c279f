"""Which parts of its goal each robot is shown: drawn with the episode, kept as bits."""

from dataclasses import dataclass, field

import torch

from core.errors import InputError
from core.structured import at_least
from policy.goals import KINDS, PARTS, bits_of
from train.mdp.draws import choice, rand

RANDOM = "random"
CPU = "cpu"  # where goals are drawn


@dataclass(frozen=True)
class GoalSettings:
    """``kinds``: share by kind of goal. ``random``: every part with the same chance, drawn for each robot."""

    kinds: dict[str, float] = field(default_factory=lambda: {"full": 1.0})

    def __post_init__(self) -> None:
        for name, share in self.kinds.items():
            where = f"environment.goals.kinds.{name}"
            if name not in (*KINDS, RANDOM):
                raise InputError("no such kind of goal", where=where, expected=", ".join((*KINDS, RANDOM)))
            at_least(where, share, 0.0)
        if not sum(self.kinds.values()) > 0.0:
            raise InputError("no share above 0", where="environment.goals.kinds", got=dict(self.kinds))


class Goals:
    """Draws goals.

    Args:
        settings: None: every robot sees everything.
        generator: source of randomness.
    """

    def __init__(self, settings: GoalSettings | None, generator: torch.Generator) -> None:
        kinds = {"full": 1.0} if settings is None else settings.kinds
        bits = [0 if name == RANDOM else bits_of(KINDS[name]) for name in kinds]
        self._shares = torch.tensor([list(kinds.values())], device=CPU)
        self._random = torch.tensor([name == RANDOM for name in kinds], device=CPU)
        self._bits = torch.tensor(bits, device=CPU)
        self._fixed, self._generator = settings is None, generator

    def draw(self, number: int) -> torch.Tensor:
        """Bits (n,) of what each robot is shown."""
        if self._fixed:
            return self._bits.expand(number).clone()
        kind = choice(self._shares.expand(number, -1), self._generator)
        chance = rand((number, 1), self._generator, CPU)
        shown = rand((number, len(PARTS)), self._generator, CPU) < chance
        drawn = (shown.long() << torch.arange(len(PARTS), device=CPU)).sum(dim=1)
        return torch.where(self._random[kind], drawn, self._bits[kind])


def visible(bits: torch.Tensor) -> torch.Tensor:
    """(n,) bits → (n, V) ones and zeros."""
    return ((bits[:, None] >> torch.arange(len(PARTS), device=bits.device)) & 1).float()


def errors_by_kind(settings: GoalSettings | None, bits: torch.Tensor, error_mm: torch.Tensor) -> dict[str, float]:
    """Mean error (B,) of the robots that are shown each kind of goal, ``goal/KIND_empbpe_mm``; others are random."""
    if settings is None:
        return {}
    known = {name: bits == bits_of(KINDS[name]) for name in settings.kinds if name != RANDOM}
    if RANDOM in settings.kinds:
        known[RANDOM] = ~torch.stack([*known.values(), torch.zeros_like(bits, dtype=torch.bool)]).any(dim=0)
    return {f"goal/{name}_empbpe_mm": float(error_mm[of].mean()) for name, of in known.items() if of.any()}
