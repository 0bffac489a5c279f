"""The last steps of every simulated robot, in memory that two processes share."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from train.batch import Device
from train.mdp.draws import whole

MARGIN = 40  # steps before a sampled one that its history and its queue may reach back to


@dataclass(frozen=True)
class Steps:
    """What is known of the moment before a step of N robots.

    Attributes:
        state: (N, 13 + 2J) packed.
        target: (N, J) joint targets of the step.
        context: (N, C + 6) packed.
        clip, tick, age: (N,) what is tracked, where in it, and the steps since the episode began.
        goal: (N,) bits of what of it the robot is shown.
        segment: (N,) changes wherever a state does not follow from the one before by a step alone.
    """

    state: Tensor
    target: Tensor
    context: Tensor
    clip: Tensor
    tick: Tensor
    age: Tensor
    goal: Tensor
    segment: Tensor


class Ring:
    """The last T steps of N robots.

    Args:
        steps: T.
        num_envs: N.
        sizes: columns of state, target and context.
        device: where it is; memory is shared on a CPU alone.
    """

    def __init__(self, steps: int, num_envs: int, sizes: tuple[int, int, int], device: Device) -> None:
        self.steps, self.num_envs, self.device = steps, num_envs, torch.device(device)

        def shared(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            made = torch.zeros(*shape, dtype=dtype, device=self.device)
            return made.share_memory_() if self.device.type == "cpu" else made

        # Half precision holds scales and shares to 0.05 %.
        formats = (torch.float32, torch.float32, torch.float16)
        wide = (shared(steps, num_envs, n, dtype=kind) for n, kind in zip(sizes, formats, strict=True))
        self._stored = Steps(*wide, *(shared(steps, num_envs, dtype=torch.int32) for _ in range(5)))
        self.next, self.count = 0, 0

    def write(self, now: Steps) -> None:
        """Add a step of every robot, in place of the oldest."""
        for stored, values in zip(vars(self._stored).values(), vars(now).values(), strict=True):
            stored[self.next] = values
        self.next, self.count = (self.next + 1) % self.steps, min(self.count + 1, self.steps)

    def sample(self, number: int, length: int, newest: int | None, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """``number`` windows of ``length`` steps and one more, among the ``newest`` steps (None: all).

        Returns (length + 1, number) places in time, each following the one before, and robots (number,).
        """
        reach = self.count - length - MARGIN
        reach = reach if newest is None else min(newest, reach)
        back = whole(length + 1, reach + length + 1, number, generator, self.device)
        robots = whole(0, self.num_envs, number, generator, self.device)
        first = (self.next - back) % self.steps
        return (first[None] + torch.arange(length + 1, device=self.device)[:, None]) % self.steps, robots

    def at(self, times: Tensor, robots: Tensor) -> Steps:
        """What was known at places in time of robots; any shapes that fit each other."""
        state, target, context, *whole = (part[times, robots] for part in vars(self._stored).values())
        return Steps(state, target, context.float(), *(part.long() for part in whole))

    def targets(self, times: Tensor, robots: Tensor) -> Tensor:
        """Targets alone, of :meth:`at`."""
        return self._stored.target[times, robots]

    def states(self, times: Tensor, robots: Tensor) -> Tensor:
        """States alone, of :meth:`at`."""
        return self._stored.state[times, robots]

    def segments(self, times: Tensor, robots: Tensor) -> Tensor:
        """Segments alone, of :meth:`at`."""
        return self._stored.segment[times, robots]

    def targets_before(self, times: Tensor, robots: Tensor, age: Tensor, first: Tensor) -> tuple[Tensor, Tensor]:
        """The two targets before places in time (n,); an episode's queue begins filled with its ``first`` (n, J)."""
        one = torch.where(age[:, None] >= 1, self.targets((times - 1) % self.steps, robots), first)
        two = torch.where(age[:, None] >= 2, self.targets((times - 2) % self.steps, robots), one)
        return one, two

    def state_dict(self) -> dict[str, Any]:
        """What has been written."""
        stored = {name: part[: self.count].clone() for name, part in vars(self._stored).items()}
        return {"next": self.next, "count": self.count, **stored}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.next, self.count = state["next"], state["count"]
        for name, part in vars(self._stored).items():
            part[: self.count] = state[name]
