"""What is tracked: drawn at each reset, compared with at each step."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from policy.reference import ReferenceWindow
from train.mdp.clip_sampler import ClipFigures, ClipSampler
from train.mdp.failures import FailureRates
from train.mdp.gait import tick_in_step, told_speeds_alone, window_in_step
from train.mdp.goals import Goals, visible
from train.mdp.settings import EnvironmentSettings
from train.mdp.starts import StartSampler
from train.mdp.state import EnvState
from train.mdp.tick import ReferenceRows, ReferenceTable


@dataclass(frozen=True)
class EpisodeStart:
    """Where n episodes begin: clip, tick, whether it was drawn uniformly (n,), and the reference's rows there."""

    clip: torch.Tensor
    tick: torch.Tensor
    uniform: torch.Tensor
    rows: ReferenceRows
    qpos: torch.Tensor
    qvel: torch.Tensor


class Command:
    """Clips, and where in them robots are. A set of one clip is the usual case.

    Args:
        names: of the clips.
        table: the references, in the same order.
        settings: how clips and start times are drawn; how long an episode lasts.
        generator: source of what each episode draws.
        dt_s: control period.
    """

    def __init__(
        self,
        names: Sequence[str],
        table: ReferenceTable,
        settings: EnvironmentSettings,
        generator: torch.Generator,
        dt_s: float,
    ) -> None:
        device = table.num_ticks.device
        self.names, self.table, self.num_ticks = tuple(names), table, table.num_ticks
        self._most_steps = round(settings.termination.max_episode_s / dt_s)
        self._last_tick = table.num_ticks + round(settings.termination.hold_s / dt_s)
        self.failures = FailureRates(table.num_ticks)
        self._starts = StartSampler(settings.start, table.num_ticks, generator)
        self._clips = ClipSampler(settings.clips, generator)
        self._figures = ClipFigures(self.names, device)
        self.goals, self._dt_s = Goals(settings.goals, self.names, generator), dt_s
        self._reach = 0 if settings.teacher is None else round(self.goals.settings.phase_s / dt_s)

    def draw(self, env_ids: torch.Tensor) -> EpisodeStart:
        """Clips, start ticks and start states of the episodes that robots ``env_ids`` (n,) begin."""
        clip = self._clips.draw(env_ids, 1.0 - self.failures.survival())
        tick, uniform = self._starts.draw(clip, self.failures.ahead())
        rows = self.table.rows(clip, tick)
        return EpisodeStart(clip, tick, uniform, rows, *self._starts.state(rows, tick == 0))

    def hard(self) -> torch.Tensor:
        """Weights (C, bins) of half seconds by how often robots fail soon after them; see :class:`StartSampler`."""
        failing = self.failures.ahead()
        return self._clips.shares(1.0 - self.failures.survival())[:, None] * self._starts.weights(failing)

    def begin(self, state: EnvState, env_ids: torch.Tensor, start: EpisodeStart) -> None:
        """Write the episodes that ``env_ids`` (n,) begin into ``state``."""
        state.clip[env_ids], state.tick[env_ids], state.start_tick[env_ids] = start.clip, start.tick, start.tick
        state.goal[env_ids] = self.goals.draw(start.clip)
        state.uniform_start[env_ids] = start.uniform
        state.episode_steps[env_ids] = 0
        state.target.write(env_ids, self.table.rows(start.clip, start.tick + 1))

    def advance(self, state: EnvState, generator: torch.Generator) -> None:
        """A control tick passes; what it draws is from ``generator``."""
        state.tick += 1
        state.episode_steps += 1
        state.goal = self.goals.after_tick(state.goal, state.clip, self._dt_s, generator)

    def next_target(self, state: EnvState) -> ReferenceRows:
        """What the robots will be compared with after the next step."""
        return self.table.rows(state.clip, state.tick + 1)

    def window(self, state: EnvState, rows: torch.Tensor, ticks: tuple[int, ...]) -> ReferenceWindow | None:
        """The reference so many ticks ahead of the robots ``rows`` (n,); None where there are no ticks."""
        if not ticks:
            return None
        window = self.table.window(state.clip[rows], state.tick[rows], ticks)
        if self._reach:
            window = self._in_step(window, state, rows)
        return replace(window, visible=visible(state.goal[rows]))

    def _in_step(self, window: ReferenceWindow, state: EnvState, rows: torch.Tensor) -> ReferenceWindow:
        """What a teacher shall follow of robots that are told speeds alone; they see ``steer``, which stays."""
        (free,) = told_speeds_alone(state.goal[rows]).nonzero(as_tuple=True)
        who = rows[free]
        clip, joints = state.clip[who], (state.physics.joint_pos_rad[who], state.physics.joint_vel_rad_s[who])
        tick = tick_in_step(self.table, clip, state.tick[who], *joints, self._reach)
        return window_in_step(window, self.table.window(clip, tick, window.ticks), free)

    def is_over(self, state: EnvState) -> torch.Tensor:
        """Whose episode (B,) has come to its end, or lasted as long as one may."""
        return (state.tick >= self._last_tick[state.clip]) | (state.episode_steps >= self._most_steps)

    def length_ratio(self, state: EnvState) -> torch.Tensor:
        """How much of what it could last (B,) each episode has lasted."""
        possible = (self._last_tick[state.clip] - state.start_tick).clamp(max=self._most_steps)
        return state.episode_steps / possible

    def update(self, state: EnvState, failed: torch.Tensor, ended: torch.Tensor, error_mm: torch.Tensor) -> None:
        """Take in a step (B,): who failed, whose episode ends, the body errors."""
        self.failures.update(state.clip, state.tick, failed)
        if len(self.names) > 1:
            self._figures.update(state.clip, error_mm, ended, self.length_ratio(state))

    def figures(self) -> dict[str, float]:
        """What is known of each clip, ``clip/NAME/…``; nothing where there is only one."""
        return self._figures.named(self.failures.survival()) if len(self.names) > 1 else {}

    def state_dict(self) -> dict[str, Any]:
        """What was learnt of the clips."""
        return {"failures": self.failures.state_dict(), "figures": self._figures.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.failures.load_state_dict(state["failures"])
        self._figures.load_state_dict(state["figures"])
