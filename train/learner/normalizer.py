"""Running normalisation of what the critic sees."""

import torch
from torch import Tensor, nn

from train.distributed import Alone, Reduce
from train.interface import Columns, width

PHASE_MEMORY = 0.95
INPUT_CLIP = 5.0
SPREAD_MIN = 1e-3


class PhaseNormalizer(nn.Module):
    """How far an observation (..., n) is off what is usual at its phase; by :meth:`fold` also where it is.

    What a state is worth hangs on centimetres and tenths of a radian off a motion that itself moves by half a metre
    and a radian: a network that sees only where things are takes long to tell. Until the first update both are
    the observation itself; each update then counts for the share 1 - ``PHASE_MEMORY`` of what is known. What is off
    is clipped to ±``INPUT_CLIP``.

    Args:
        size: n.
        knots: the last columns of the observation, which weigh the knots of its phase
            (:func:`train.phase_basis.phase_hats`) and are passed on as they are.
        reduce: joins what the processes of a training saw.
    """

    _weight: Tensor
    _sum: Tensor
    _square: Tensor
    _square_off: Tensor
    mean: Tensor
    usual: Tensor
    spread: Tensor
    spread_off: Tensor

    def __init__(self, size: int, knots: int, reduce: Reduce | None = None) -> None:
        super().__init__()
        self._reduce = reduce or Alone()
        columns = size - knots
        self._knots, self.weight_columns = knots, 2 * columns + knots
        for name, shape, value in (
            ("_weight", (knots,), 0.0), ("_sum", (knots, columns), 0.0),
            ("_square", (columns,), 0.0), ("_square_off", (columns,), 0.0),
            ("mean", (columns,), 0.0), ("usual", (knots, columns), 0.0),
            ("spread", (columns,), 1.0), ("spread_off", (columns,), 1.0),
        ):  # fmt: skip
            self.register_buffer(name, torch.full(shape, value, device="cpu"))

    def forward(self, observation: Tensor) -> Tensor:
        """(..., n) → (..., n): off the usual, in spreads, and the knots' weights."""
        x, hats = observation[..., : -self._knots], observation[..., -self._knots :]
        off = (x - hats @ self.usual) / self.spread_off
        return torch.cat([off.clamp(-INPUT_CLIP, INPUT_CLIP), hats], dim=-1)

    def fold(self, weight: Tensor) -> Tensor:
        """Weight (units, ``weight_columns``) for [where it is, off the usual, knots] → (units, n) for the output.

        Where it is, (x - mean) / spread, is linear in the other two, as far as these are not clipped and as the knots'
        weights sum to 1: a layer learns weights for all three, and is given half of the inputs.
        """
        columns = len(self.mean)
        whole, off, hats = weight.split([columns, columns, self._knots], dim=-1)
        usual = (self.usual - self.mean) / self.spread
        return torch.cat([whole * (self.spread_off / self.spread) + off, hats + whole @ usual.T], dim=-1)

    @torch.no_grad()
    def update(self, observation: Tensor) -> None:
        """Take in observations (m, n)."""
        x, hats = observation[:, : -self._knots], observation[:, -self._knots :]
        self._remember(self._weight, hats.sum(dim=0))
        self._remember(self._sum, hats.T @ x)
        self._remember(self._square, x.square().sum(dim=0))
        count = self._weight.sum()
        self.mean.copy_(self._sum.sum(dim=0) / count)
        seen = self._weight[:, None] > 0.0
        self.usual.copy_(torch.where(seen, self._sum / self._weight[:, None], self.mean))
        self._remember(self._square_off, (x - hats @ self.usual).square().sum(dim=0))
        self.spread.copy_((self._square / count - self.mean.square()).clamp(min=0.0).sqrt() + SPREAD_MIN)
        self.spread_off.copy_((self._square_off / count).sqrt() + SPREAD_MIN)

    def _remember(self, total: Tensor, fresh: Tensor) -> None:
        total.mul_(PHASE_MEMORY).add_(self._reduce.sum(fresh))


def normalizer_of(columns: Columns, reduce: Reduce) -> PhaseNormalizer | None:
    """What the critic's observation asks for: one by phase where its last term weighs knots of the phase."""
    knots = columns.get("phase_knots")
    return None if knots is None else PhaseNormalizer(width(columns), knots.stop - knots.start, reduce)
