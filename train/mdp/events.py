"""What happens to robots from time to time: one function each, called for those whose wait is over."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import torch

from core.structured import ordered, positive
from train.batch import Device
from train.mdp.draws import uniform
from train.mdp.physics import Physics
from train.mdp.registry import Registry

EVENTS: Registry[Callable[..., None]] = Registry("event")


@EVENTS
def push(
    physics: Physics, due: torch.Tensor, strength: float, generator: torch.Generator, *, velocity_m_s: float
) -> None:
    """Add a horizontal velocity drawn from ± ``velocity_m_s`` · ``strength`` in x and y to the robots ``due`` (n,)."""
    velocity = uniform((len(due), 2), -1.0, 1.0, generator, due.device) * velocity_m_s
    physics.push(due, velocity * strength)


@dataclass(frozen=True)
class EventTerm:
    """An event happens to each robot at intervals drawn from ``interval_s``, with its parameters."""

    interval_s: tuple[float, float]
    params: dict[str, float] = field(default_factory=dict)

    def check(self, where: str, name: str) -> None:
        """InputError unless there is such an event, at a positive interval."""
        EVENTS.check(where, name, self.params)
        ordered(f"{where}.interval_s", self.interval_s)
        positive(f"{where}.interval_s[0]", self.interval_s[0])


class Events:
    """Calls each event for each robot at random intervals.

    Args:
        settings: event → interval and parameters.
        dt_s: control period.
        generator: source of randomness.
        device: where the waits are.
    """

    def __init__(
        self, settings: Mapping[str, EventTerm], dt_s: float, generator: torch.Generator, device: Device
    ) -> None:
        self._terms = [(EVENTS.bound(name, term.params), term.interval_s) for name, term in settings.items()]
        self._dt_s, self._generator, self._device = dt_s, generator, device

    def first_waits(self, num_envs: int) -> torch.Tensor:
        """Seconds (B, E) until each event happens to each robot for the first time."""
        waits = [uniform((num_envs,), 0.0, longest, self._generator, self._device) for _, (_, longest) in self._terms]
        return torch.stack(waits, dim=1) if waits else torch.zeros(num_envs, 0, device=self._device)

    def apply(self, wait_s: torch.Tensor, physics: Physics, strength: float) -> torch.Tensor:
        """Count one control period off ``wait_s`` (B, E); what is due happens with ``strength`` in [0, 1].

        Returns to whom (B,) anything did.
        """
        wait_s -= self._dt_s
        happened = (wait_s <= 0.0).any(dim=1)
        for column, (event, interval_s) in enumerate(self._terms):
            due = (wait_s[:, column] <= 0.0).nonzero()[:, 0]
            if len(due):
                wait_s[due, column] = uniform((len(due),), *interval_s, self._generator, self._device)
                event(physics, due, strength, self._generator)
        return happened
