"""Which parts of its goal each robot is shown: drawn with the episode and within it, kept as bits.

Bit k is part k of :data:`policy.goals.PARTS`. The number above these bits is how many ticks of a gap are left, in which
nothing is shown; after it the same parts are shown again.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import torch

from core.errors import InputError
from core.structured import at_least, ordered, within
from policy.goals import KINDS, PARTS, POINTS, bits_of
from train.mdp.draws import choice, rand

RANDOM = "random"
BODIES = "bodies"
CPU = "cpu"  # where goals are drawn

# What a body's place and its turn are among the parts: the pelvis, then the points (MaskedMimic: six bodies).
PLACES = (("place",), *((point,) for point in POINTS))
TURNS = (("posture", "heading"), *((f"{point}_turn",) for point in POINTS))
FEW, FEW_SHARE = 3, 0.1  # in so many draws at most so many bodies


@dataclass(frozen=True)
class KindsOf:
    """Shares of kinds of some clips: those whose whole name is what the regular expression ``clips`` says."""

    clips: str
    kinds: dict[str, float]

    def __post_init__(self) -> None:
        try:
            re.compile(self.clips)
        except re.error as e:
            raise InputError("no regular expression", where="clips", got=f"{self.clips} ({e})") from None
        _check_shares("kinds", self.kinds)


@dataclass(frozen=True)
class GoalSettings:
    """How robots are shown parts of their goal.

    Attributes:
        kinds: share by kind of goal. ``random``: every part with the same chance, drawn for each robot; ``bodies``: one
            to six bodies, of each its place, its turn or both, as MaskedMimic hides its near poses.
        kinds_of: other shares of some clips, by a name for them; the first that fits counts.
        redraw_per_s: how often a second the kind is drawn anew within an episode.
        gap_per_s: how often a second a gap begins, in which nothing is shown.
        gap_s: how long gaps last, uniform.
        phase_s: of robots that are told speeds alone, how far in time the reference may be moved to where its pose is
            theirs: for the cost in imagination, and for a teacher. Half a step is enough.
    """

    kinds: dict[str, float] = field(default_factory=lambda: {"full": 1.0})
    kinds_of: dict[str, KindsOf] | None = None
    redraw_per_s: float = 0.0
    gap_per_s: float = 0.0
    gap_s: tuple[float, float] = (0.0, 0.0)
    phase_s: float = 0.0

    def __post_init__(self) -> None:
        _check_shares("environment.goals.kinds", self.kinds)
        for name in ("redraw_per_s", "gap_per_s"):
            at_least(f"environment.goals.{name}", getattr(self, name), 0.0)
        ordered("environment.goals.gap_s", self.gap_s)
        within("environment.goals.phase_s", self.phase_s, 0.0, 2.0)

    def names(self) -> tuple[str, ...]:
        """Every kind that has a share."""
        others = [of.kinds for of in (self.kinds_of or {}).values()]
        return tuple(dict.fromkeys(name for kinds in (self.kinds, *others) for name in kinds))

    def of(self, clip: str) -> dict[str, float]:
        """The shares of a clip."""
        fitting = (of.kinds for of in (self.kinds_of or {}).values() if re.fullmatch(of.clips, clip))
        return next(fitting, self.kinds)


def _check_shares(where: str, kinds: Mapping[str, float]) -> None:
    for name, share in kinds.items():
        if name not in (*KINDS, RANDOM, BODIES):
            known = ", ".join((*KINDS, RANDOM, BODIES))
            raise InputError("no such kind of goal", where=f"{where}.{name}", expected=known)
        at_least(f"{where}.{name}", share, 0.0)
    if not sum(kinds.values()) > 0.0:
        raise InputError("no share above 0", where=where, got=dict(kinds))


class Goals:
    """Draws goals.

    Args:
        settings: None: every robot sees everything.
        clips: names of the C clips.
        generator: source of what each episode draws.
    """

    def __init__(self, settings: GoalSettings | None, clips: Sequence[str], generator: torch.Generator) -> None:
        self.settings = settings or GoalSettings()
        kinds = self.settings.names()
        bits = [bits_of(KINDS.get(name, ())) for name in kinds]
        shares = [[of.get(kind, 0.0) for kind in kinds] for of in map(self.settings.of, clips)]
        self._shares = torch.tensor(shares, device=CPU)
        self._drawn = {name: torch.tensor([kind == name for kind in kinds], device=CPU) for name in (RANDOM, BODIES)}
        self._bits = torch.tensor(bits, device=CPU)
        self._fixed, self._generator = settings is None, generator

    def draw(self, clip: torch.Tensor, generator: torch.Generator | None = None) -> torch.Tensor:
        """Bits (n,) of what robots in clips (n,) are shown, on their device.

        They are drawn from another source than that of episodes where one is given.
        """
        number = len(clip)
        if self._fixed:
            return self._bits.expand(number).clone().to(clip.device)
        return self._drawn_for(clip.cpu(), self._generator if generator is None else generator).to(clip.device)

    def _drawn_for(self, clip: torch.Tensor, source: torch.Generator) -> torch.Tensor:
        number, kind = len(clip), choice(self._shares[clip], source)
        chance = rand((number, 1), source, CPU)
        shown = rand((number, len(PARTS)), source, CPU) < chance
        drawn = (shown.long() << torch.arange(len(PARTS), device=CPU)).sum(dim=1)
        bits = torch.where(self._drawn[RANDOM][kind], drawn, self._bits[kind])
        if not self._drawn[BODIES].any():
            return bits
        return torch.where(self._drawn[BODIES][kind], _bodies(number, source), bits)

    def after_tick(
        self, bits: torch.Tensor, clip: torch.Tensor, dt_s: float, generator: torch.Generator
    ) -> torch.Tensor:
        """Bits (B,) of robots in clips (B,) a tick of ``dt_s`` later.

        Some are drawn anew, gaps end and begin, where the settings have any.
        """
        s, number = self.settings, len(bits)
        if s.redraw_per_s == 0.0 and s.gap_per_s == 0.0:
            return bits
        shown, left = bits.cpu() % (1 << len(PARTS)), (bits.cpu() >> len(PARTS)).sub(1).clamp(min=0)
        redrawn = rand((number,), generator, CPU) < s.redraw_per_s * dt_s
        shown = torch.where(redrawn, self.draw(clip.cpu(), generator), shown)
        begins = (rand((number,), generator, CPU) < s.gap_per_s * dt_s) & (left == 0)
        shortest, longest = s.gap_s
        lasts_s = shortest + (longest - shortest) * rand((number,), generator, CPU)
        left = torch.where(begins, (lasts_s / dt_s).round().long().clamp(min=1), left)
        return (shown + (left << len(PARTS))).to(bits.device)


def _bodies(number: int, generator: torch.Generator) -> torch.Tensor:
    """Bits (n,) of some of the six bodies, of each its place, both, or its turn, a third each.

    How many is 1 + U(0, 1) (M - 1), rounded; M is 6, in a tenth of the draws 3 (MaskedMimic).
    """
    few = rand((number,), generator, CPU) < FEW_SHARE
    most = torch.where(few, float(FEW), float(len(PLACES)))
    count = (1.0 + rand((number,), generator, CPU) * (most - 1.0)).round()
    rank = rand((number, len(PLACES)), generator, CPU).argsort(dim=1).argsort(dim=1)
    how = (3.0 * rand((number, len(PLACES)), generator, CPU)).long()
    places, turns = (torch.tensor([bits_of(parts) for parts in of], device=CPU) for of in (PLACES, TURNS))
    bits = torch.where(how < 2, places, 0) + torch.where(how > 0, turns, 0)
    return torch.where(rank < count[:, None], bits, 0).sum(dim=1)


def visible(bits: torch.Tensor) -> torch.Tensor:
    """(n,) bits → (n, V) ones and zeros."""
    shown = torch.where(bits >> len(PARTS) > 0, 0, bits)
    return ((shown[:, None] >> torch.arange(len(PARTS), device=bits.device)) & 1).float()


def shows(bits: torch.Tensor, part: str) -> torch.Tensor:
    """Whether robots (n,) see a part of their goal, unless a gap hides it for a moment."""
    return bits & bits_of((part,)) > 0


def errors_by_kind(settings: GoalSettings | None, bits: torch.Tensor, error_mm: torch.Tensor) -> dict[str, float]:
    """Mean error (B,) of the robots that are shown each kind of goal, ``goal/KIND_empbpe_mm``.

    ``gap``: of those in one; ``random``: of all that were drawn part by part or body by body.
    """
    if settings is None:
        return {}
    known = {"gap": bits >> len(PARTS) > 0}
    known |= {name: bits == bits_of(KINDS[name]) for name in settings.names() if name in KINDS}
    if {RANDOM, BODIES} & {*settings.names()}:
        known[RANDOM] = ~torch.stack([*known.values()]).any(dim=0)
    return {f"goal/{name}_empbpe_mm": float(error_mm[of].mean()) for name, of in known.items() if of.any()}
