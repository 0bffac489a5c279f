"""Pairs of robots that differ in nothing but what they are told to do."""

from collections.abc import Mapping
from typing import Any

import torch

from train.interface import StepResult
from train.mdp.tracking import TrackingEnv


class PairedEnv:
    """Environments whose second half, row by row, is a twin of the first.

    A twin is where its leader is, every ``steps`` steps and after each end of one of the two anew, and meets the same
    disturbances: pushes, noise of sensors and torques, and whatever was drawn for the robot or its episode. What
    differs between their returns comes from their actions alone (common random numbers: Ng and Jordan, "PEGASUS", UAI
    2000). A twin's episode times out where it goes back to its leader. Curricula, tolerances and figures are the
    leaders'.

    Args:
        leaders, twins: two environments built alike.
        steps: see above.
    """

    def __init__(self, leaders: TrackingEnv, twins: TrackingEnv, steps: int) -> None:
        self._leaders, self._twins, self._steps, self._together = leaders, twins, steps, 0
        self.num_envs, self.num_actions = 2 * leaders.num_envs, leaders.num_actions
        self.layout, self.device, self.reward_names = leaders.layout, leaders.device, leaders.reward_names
        self._everyone = torch.ones(leaders.num_envs, dtype=torch.bool)
        self._twins.follow(leaders, self._everyone)

    def reset(self) -> dict[str, torch.Tensor]:
        """Begin a new episode in every environment; return its observations."""
        observations = self._leaders.reset()
        self._twins.follow(self._leaders, self._everyone)
        self._together = 0
        return _joined(observations, observations)

    def step(self, actions: torch.Tensor) -> StepResult:
        """Advance by one control period with raw actions (B, J)."""
        first, second = actions.chunk(2)
        led, twin = self._leaders.step(first), self._twins.step(second)
        self._together = (self._together + 1) % self._steps
        apart = led.terminated | led.timed_out | twin.terminated | twin.timed_out
        if self._together == 0:
            apart = self._everyone
        if apart.any():
            twin = _cut(twin, apart, led.observations)
            self._twins.follow(self._leaders, apart)
        return StepResult(
            _joined(led.observations, twin.observations),
            torch.cat([led.rewards, twin.rewards]),
            torch.cat([led.terminated, twin.terminated]),
            torch.cat([led.timed_out, twin.timed_out]),
            torch.cat([led.final_critic_obs, twin.final_critic_obs]),
            led.log,
        )

    def figures(self) -> dict[str, float]:
        """See :class:`train.interface.Environment`; the leaders'."""
        return self._leaders.figures()

    def finish_iteration(self) -> None:
        """See :class:`train.interface.Environment`."""
        for env in (self._leaders, self._twins):
            env.finish_iteration()

    def state_dict(self) -> dict[str, Any]:
        """Everything that a continued run needs."""
        return {
            "leaders": self._leaders.state_dict(), "twins": self._twins.state_dict(), "together": self._together,
        }  # fmt: skip

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self._leaders.load_state_dict(state["leaders"])
        self._twins.load_state_dict(state["twins"])
        self._together = state["together"]


def _joined(first: Mapping[str, torch.Tensor], second: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: torch.cat([first[name], second[name]]) for name in first}


def _cut(result: StepResult, rows: torch.Tensor, following: Mapping[str, torch.Tensor]) -> StepResult:
    """The same step with a time-out of those episodes of ``rows`` (B,) bool that go on, where others follow."""
    timed_out = result.timed_out | (rows & ~result.terminated)
    last = result.observations["critic"].clone()
    last[result.timed_out] = result.final_critic_obs
    observations = {name: torch.where(rows[:, None], following[name], own) for name, own in result.observations.items()}
    return StepResult(observations, result.rewards, result.terminated, timed_out, last[timed_out], result.log)
