"""Actor and critic: plain MLPs whose hidden layers may run in bf16 and whose output layers stay in fp32."""

import copy
import math
from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn

ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "silu": nn.SiLU, "relu": nn.ReLU}


def _linear(inputs: int, outputs: int, generator: torch.Generator, gain: float = 1.0) -> nn.Linear:
    """A layer drawn from ``generator``: weights and bias uniform in ±gain/sqrt(inputs)."""
    layer = nn.utils.skip_init(nn.Linear, inputs, outputs)
    bound = gain / math.sqrt(inputs)
    with torch.no_grad():
        for parameter in layer.parameters():
            parameter.uniform_(-bound, bound, generator=generator)
    return layer


class Residual(nn.Module):
    """What an actor's network is: (..., ``input_size``) → (..., J).

    ``half_suffices``: whether half precision holds its weights as finely as training sets them.
    """

    input_size: int
    half_suffices = False

    def stored(self, x: Tensor) -> Tensor:
        """Inputs as they are kept for later passes."""
        return x


class Mlp(Residual):
    """Hidden layers and a linear output (..., outputs).

    Args:
        inputs: size of the input.
        hidden: sizes of the hidden layers.
        outputs: size of the output.
        activation: of :data:`ACTIVATIONS`.
        generator: source of the initial weights.
        output_gain: factor on the initial output layer; small starts near zero.
        precision: ``bf16`` or ``fp32``, of the hidden layers.
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
    ) -> None:
        super().__init__()
        self.input_size = inputs
        sizes = [inputs, *hidden]
        layers: list[nn.Module] = []
        for size, following in pairwise(sizes):
            layers += [_linear(size, following, generator), ACTIVATIONS[activation]()]
        self.hidden = nn.Sequential(*layers)
        self.output = _linear(sizes[-1], outputs, generator, output_gain)
        self.low_precision = precision == "bf16"

    def stored(self, x: Tensor) -> Tensor:
        """x as its first layer takes it: half of the size in bf16."""
        return x.bfloat16() if self.low_precision else x

    def forward(self, x: Tensor) -> Tensor:
        """(..., inputs) → (..., outputs) float32."""
        if self.low_precision:
            with torch.autocast(x.device.type, torch.bfloat16):
                x = self.hidden(x)
            x = x.float()
        else:
            x = self.hidden(x)
        return self.output(x)


class ActorNetwork(nn.Module):
    """Gaussian policy: mean = prior(obs) + residual, one standard deviation per action.

    Args:
        mlp: the residual, or without a prior the whole mean.
        num_actions: J.
        noise_std: (start, lowest, highest) standard deviation.
        prior: optional module without weights: observations (B, Da) → an action (B, J), to which the residual is added.
    """

    def __init__(
        self,
        mlp: Residual,
        num_actions: int,
        noise_std: tuple[float, float, float],
        prior: nn.Module | None = None,
    ) -> None:
        super().__init__()
        self.mlp, self.prior = mlp, prior
        self.observation_size = mlp.input_size
        start, low, high = noise_std
        self._log_bounds = math.log(low), math.log(high)
        self.log_std = nn.Parameter(torch.full((num_actions,), math.log(start), device=next(mlp.parameters()).device))

    def prepare(self, obs: Tensor) -> dict[str, Tensor]:
        """What :meth:`mean` needs of obs (B, Da), and what no training changes."""
        inputs = {"inputs": self.mlp.stored(obs)}
        return inputs if self.prior is None else inputs | {"prior": self.prior(obs)}

    def mean(self, inputs: Tensor, prior: Tensor | None = None) -> Tensor:
        """Mean action (B, J) of what :meth:`prepare` returned."""
        residual = self.mlp(inputs)
        return residual if prior is None else prior + residual

    def forward(self, obs: Tensor) -> Tensor:
        """Mean action (B, J) of obs (B, Da)."""
        return self.mean(**self.prepare(obs))

    def deployed(self) -> "ActorNetwork":
        """A copy as it is exported: everything in fp32, no gradients."""
        twin = copy.deepcopy(self).eval().requires_grad_(False)
        for module in twin.modules():
            if "low_precision" in vars(module):
                vars(module)["low_precision"] = False
        return twin

    @torch.no_grad()
    def limit_noise(self) -> None:
        """Bring the standard deviation back inside its bounds (after an optimiser step)."""
        self.log_std.clamp_(*self._log_bounds)


class CriticNetwork(nn.Module):
    """State values (..., H), one head per group of reward columns."""

    def __init__(self, mlp: Mlp) -> None:
        super().__init__()
        self.mlp = mlp

    def prepare(self, obs: Tensor) -> dict[str, Tensor]:
        """What :meth:`values` needs of obs (..., Dc)."""
        return {"inputs": self.mlp.stored(obs)}

    def values(self, inputs: Tensor) -> Tensor:
        """Values (..., H) of what :meth:`prepare` returned."""
        return self.mlp(inputs)

    def forward(self, obs: Tensor) -> Tensor:
        """Values (..., H) of obs (..., Dc)."""
        return self.values(**self.prepare(obs))
