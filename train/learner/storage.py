"""The samples of one iteration, in tensors allocated once."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Sizes:
    """T steps of B environments; Da, Dc observation sizes; J actions; H value heads."""

    horizon: int
    num_envs: int
    actor_obs: int
    critic_obs: int
    actions: int
    heads: int


@dataclass
class Batch:
    """Samples (n, ·) of one minibatch; ``base`` (n, J) is the part of the mean that is not trained."""

    actor_inputs: Tensor
    critic_inputs: Tensor
    base: Tensor
    actions: Tensor
    old_mean: Tensor
    old_log_prob: Tensor
    advantages: Tensor
    values: Tensor
    returns: Tensor


class Storage:
    """Preallocated (T, B, ·) tensors. ``input_dtype`` is that of the networks' inputs (bf16 halves their size)."""

    def __init__(self, sizes: Sizes, input_dtype: torch.dtype, device: torch.device) -> None:
        self.sizes, self.step = sizes, 0

        def allocate(*size: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(sizes.horizon, sizes.num_envs, *size, dtype=dtype, device=device)

        self.actor_inputs = allocate(sizes.actor_obs, dtype=input_dtype)
        self.critic_inputs = allocate(sizes.critic_obs, dtype=input_dtype)
        self.base, self.actions, self.mean = (allocate(sizes.actions) for _ in range(3))
        self.log_prob = allocate()
        self.rewards, self.values, self.returns = (allocate(sizes.heads) for _ in range(3))
        self.done = allocate(dtype=torch.bool)
        self.advantages = allocate()

    def minibatches(self, count: int, generator: torch.Generator) -> Iterator[Batch]:
        """Yield ``count`` minibatches that together hold every sample once, in an order drawn from ``generator``."""
        total = self.sizes.horizon * self.sizes.num_envs
        order = torch.randperm(total, generator=generator, device=self.rewards.device)
        columns = (
            self.actor_inputs, self.critic_inputs, self.base, self.actions, self.mean,
            self.log_prob, self.advantages, self.values, self.returns,
        )  # fmt: skip
        flat = [column.flatten(0, 1) for column in columns]
        for rows in order.tensor_split(count):
            yield Batch(*(column.index_select(0, rows) for column in flat))
