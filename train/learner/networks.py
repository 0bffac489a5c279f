"""Actor and critic: plain MLPs whose hidden layers may run in bf16 and whose output layers stay in fp32."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional

from train.learner.normalizer import PhaseNormalizer

ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "silu": nn.SiLU}


def _linear(inputs: int, outputs: int, generator: torch.Generator, gain: float = 1.0) -> nn.Linear:
    """A layer drawn from ``generator``: weights and bias uniform in ±gain/sqrt(inputs)."""
    layer = nn.utils.skip_init(nn.Linear, inputs, outputs)
    bound = gain / math.sqrt(inputs)
    with torch.no_grad():
        for parameter in layer.parameters():
            parameter.uniform_(-bound, bound, generator=generator)
    return layer


class Mlp(nn.Module):
    """Hidden layers and a linear output (..., outputs).

    Args:
        inputs: size of the input.
        hidden: sizes of the hidden layers.
        outputs: size of the output.
        activation: ``elu`` or ``silu``.
        generator: source of the initial weights.
        output_gain: factor on the initial output layer; small starts near zero.
        precision: ``bf16`` or ``fp32``, of the hidden layers.
        fold: the first layer's weight (units, inputs) → the weight on what :meth:`forward` is given, if that differs.
    """

    def __init__(
        self,
        inputs: int,
        hidden: Sequence[int],
        outputs: int,
        *,
        activation: str,
        generator: torch.Generator,
        output_gain: float = 1.0,
        precision: str = "fp32",
        fold: Callable[[Tensor], Tensor] | None = None,
    ) -> None:
        super().__init__()
        self.input_size, self._fold = inputs, fold
        sizes = [inputs, *hidden]
        layers: list[nn.Module] = []
        for size, following in pairwise(sizes):
            layers += [_linear(size, following, generator), ACTIVATIONS[activation]()]
        self.hidden = nn.Sequential(*layers)
        self.output = _linear(sizes[-1], outputs, generator, output_gain)
        self.low_precision = precision == "bf16"

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) → (..., outputs) float32."""
        if self.low_precision:
            with torch.autocast(x.device.type, torch.bfloat16):
                x = self._hidden(x)
            x = x.float()
        else:
            x = self._hidden(x)
        return self.output(x)

    def _hidden(self, x: Tensor) -> Tensor:
        if self._fold is None:
            return self.hidden(x)
        first, *others = self.hidden
        assert isinstance(first, nn.Linear)
        x = functional.linear(x, self._fold(first.weight), first.bias)
        for layer in others:
            x = layer(x)
        return x


class Features(Protocol):
    """``size`` further inputs of the network; the last ``unseen`` columns of the observation are for them alone."""

    size: int
    unseen: int


class Base(Protocol):
    """An action without trained parameters, and further inputs of the network that it has at hand."""

    @property
    def features(self) -> Features | None:
        """What is known of the further inputs, if there are any."""
        ...

    def look(self, observation: Tensor) -> tuple[Tensor, Tensor | None]:
        """Action (B, J) and features (B, size) of observations (B, Da)."""
        ...


class Actor(nn.Module):
    """Gaussian policy: mean = base(obs) + mlp(obs), one standard deviation per action.

    Args:
        mlp: network from the observation to the actions.
        num_actions: J.
        noise_std: (start, lowest, highest) standard deviation.
        base: optional module, see :class:`Base`.
    """

    def __init__(
        self,
        mlp: Mlp,
        num_actions: int,
        noise_std: tuple[float, float, float],
        base: Base | None = None,
    ) -> None:
        super().__init__()
        self.mlp, self.base = mlp, base
        features = None if base is None else base.features
        self._seen = mlp.input_size - (0 if features is None else features.size)
        self.observation_size = self._seen + (0 if features is None else features.unseen)
        start, low, high = noise_std
        self._log_bounds = math.log(low), math.log(high)
        self.log_std = nn.Parameter(torch.full((num_actions,), math.log(start)))

    def look(self, obs: Tensor) -> tuple[Tensor, Tensor | None]:
        """What the network sees of obs (B, Da), and the base's action (B, J)."""
        seen = obs[..., : self._seen]
        if self.base is None:
            return seen, None
        action, features = self.base.look(obs)
        return seen if features is None else torch.cat([seen, features], dim=-1), action

    def forward(self, obs: Tensor) -> Tensor:
        """Mean action (B, J) of obs (B, Da)."""
        inputs, base = self.look(obs)
        residual = self.mlp(inputs)
        return residual if base is None else base + residual

    @torch.no_grad()
    def limit_noise(self) -> None:
        """Bring the standard deviation back inside its bounds (after an optimiser step)."""
        self.log_std.clamp_(*self._log_bounds)


class Critic(nn.Module):
    """State values (..., H): one head per reward term, or a single one for their sum."""

    def __init__(self, mlp: Mlp, normalizer: PhaseNormalizer | None = None) -> None:
        super().__init__()
        self.mlp, self.normalizer = mlp, normalizer

    def inputs(self, obs: Tensor) -> Tensor:
        """What the network sees of obs (..., Dc)."""
        return obs if self.normalizer is None else self.normalizer(obs)

    def forward(self, obs: Tensor) -> Tensor:
        """Values (..., H) of obs (..., Dc)."""
        return self.mlp(self.inputs(obs))
