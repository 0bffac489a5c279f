"""The network of world model, policy and critic: an MLP whose products may be in bf16, masters in fp32."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

INPUT_CLIP, EXTRA_CLIP = 12.0, 8.0


class _Weights(NamedTuple):
    """Weights and biases in the format of the products, for one pass and the gradients of it."""

    first: tuple[Tensor, Tensor]
    extra: tuple[Tensor, Tensor]
    hidden: list[tuple[Tensor, Tensor]]
    output: tuple[Tensor, Tensor]


class Network(nn.Module):
    """SiLU layers on normalised inputs (N, inputs) and extras (N, extras).

    Extras are what does not depend on the state: they are encoded in one batch for a whole rollout. What is normalised
    by is set once, by :meth:`normalize_by`.

    Args:
        inputs: size of the input.
        extras: size of the extras.
        hidden: sizes of the layers.
        outputs: size of the output.
        generator: source of the initial weights.
        precision: ``bf16`` or ``fp32``, of the products.
        output_gain: factor on the initial output layer.
        exact: whether the first layer sees more of its input than bf16 holds: as a sum of two numbers.
    """

    mean: Tensor
    std: Tensor
    extra_mean: Tensor
    extra_std: Tensor

    def __init__(
        self,
        inputs: int,
        extras: int,
        hidden: Sequence[int],
        outputs: int,
        *,
        generator: torch.Generator,
        precision: str,
        output_gain: float = 1.0,
        exact: bool = False,
    ) -> None:
        super().__init__()
        first, *others = hidden
        self.first = _linear(inputs, first, generator, fan_in=inputs + extras)
        self.extra = _linear(extras, first, generator, fan_in=inputs + extras)
        self.hidden = nn.ModuleList(_linear(a, b, generator) for a, b in pairwise([first, *others]))
        self.output = _linear(hidden[-1], outputs, generator, gain=output_gain)
        for name, size in (("mean", inputs), ("extra_mean", extras)):
            self.register_buffer(name, torch.zeros(size, device="cpu"))
        for name, size in (("std", inputs), ("extra_std", extras)):
            self.register_buffer(name, torch.ones(size, device="cpu"))
        self.low_precision, self._exact = precision == "bf16", exact
        self._weights: _Weights | None = None

    @torch.no_grad()
    def normalize_by(self, inputs: Tensor, extras: Tensor, least_std: float = 1e-3) -> None:
        """Take means and spreads of samples (N, ·); no spread counts as less than ``least_std``."""
        self.mean.copy_(inputs.mean(0))
        self.std.copy_(inputs.std(0).clamp(min=least_std))
        self.extra_mean.copy_(extras.mean(0))
        self.extra_std.copy_(extras.std(0).clamp(min=least_std))

    def prepare(self) -> None:
        """Read the weights as they are now; to be called before the passes of an update, and after each change."""

        def pair(layer: nn.Linear) -> tuple[Tensor, Tensor]:
            return self._cast(layer.weight), self._cast(layer.bias)

        hidden = [pair(layer) for layer in self.hidden if isinstance(layer, nn.Linear)]
        self._weights = _Weights(pair(self.first), pair(self.extra), hidden, pair(self.output))

    def __getstate__(self) -> dict[str, object]:
        """A copy reads the weights anew: those read for an update belong to its gradients."""
        return {**self.__dict__, "_weights": None}

    def encode(self, extras: Tensor) -> Tensor:
        """What :meth:`forward` takes of extras (N, extras)."""
        assert self._weights is not None, "prepare() comes first"
        x = ((extras - self.extra_mean) / self.extra_std).clamp(-EXTRA_CLIP, EXTRA_CLIP)
        return functional.linear(self._cast(x), *self._weights.extra)

    def forward(self, inputs: Tensor, encoded: Tensor) -> Tensor:
        """(N, inputs) and encoded extras → (N, outputs) float32."""
        weights = self._weights
        assert weights is not None, "prepare() comes first"
        x = ((inputs - self.mean) / self.std).clamp(-INPUT_CLIP, INPUT_CLIP)
        coarse = self._cast(x)
        h = functional.linear(coarse, *weights.first)
        if self._exact and self.low_precision:
            # No gradient passes this part: the coarse one has it already.
            rest = (x.detach() - coarse.detach().float()).bfloat16()
            h = h + functional.linear(rest, weights.first[0].detach())
        h = functional.silu(h + encoded)
        for layer in weights.hidden:
            h = functional.silu(functional.linear(h, *layer))
        out = functional.linear(h, *weights.output)
        return out.float() if self.low_precision else out

    def _cast(self, x: Tensor) -> Tensor:
        """In the format of the products; an exported graph has no step for it."""
        return x.bfloat16() if self.low_precision else x


def _linear(inputs: int, outputs: int, generator: torch.Generator, *, gain: float = 1.0, fan_in: int = 0) -> nn.Linear:
    """Weights uniform in ± gain/sqrt(fan_in), by default of ``inputs``; biases zero."""
    layer = nn.utils.skip_init(nn.Linear, inputs, outputs)
    bound = gain / math.sqrt(fan_in or inputs)
    with torch.no_grad():
        layer.weight.uniform_(-bound, bound, generator=generator)
        layer.bias.zero_()
    return layer
