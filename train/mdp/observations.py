"""What actor and teacher see: the terms of their layouts, batched, with history; the critic's exact ones."""

from dataclasses import replace

import numpy as np
import torch

from core.rotations import projected_gravity, quat_rotate_inverse
from policy.observation import (
    entry_size,
    num_lags,
    observation_layout,
    sample_clip,
    sample_terms,
    sample_width,
    term_dims,
    term_order,
    window_ticks,
)
from policy.reference import ReferenceWindow
from policy.spec import ObservationGroup, ObservationTerm
from policy.terms import ObservationInput
from robot.robot import Robot
from train.batch import Device
from train.mdp.sensing import Senses, senses_of
from train.mdp.state import EnvState
from train.simulation.simulator import PhysicsState

LIN_VEL_SCALE = 2.0
CRITIC_LAGS = 5  # older ticks tell of what is hidden, which the critic sees


class Observations:
    """Samples the observation terms of a batch, and lays out their histories.

    Args:
        robot: the robot.
        group: the actor's layout.
        device: where the robots are.
        teacher: the layout of a teacher that looks at the same moments.
    """

    def __init__(
        self,
        robot: Robot,
        group: ObservationGroup,
        device: Device,
        teacher: ObservationGroup | None = None,
    ) -> None:
        self.group, self._device = group, device
        groups = {"actor": group} if teacher is None else {"actor": group, "teacher": teacher}
        self.layouts = {name: term_slices(one, robot.num_joints) for name, one in groups.items()}
        dims = term_dims(robot.num_joints)
        whole = replace(group, terms=tuple(entry for one in groups.values() for entry in one.terms))
        self._terms, self._lags = term_order(whole), num_lags(whole)
        self._of_block = {name: observation_layout(one, dims, self._terms) for name, one in groups.items()}
        self._index = {name: torch.as_tensor(one.index, device=device) for name, one in self._of_block.items()}
        self._clip = torch.as_tensor(sample_clip(self._terms, dims), device=device).float()
        self._width = sample_width(self._terms, dims)
        self._older = self._seen_later()
        sizes = [entry_size(t, dims) for t in self._terms]
        looks_ahead = [torch.full((n,), bool(t.ticks), device=device) for n, t in zip(sizes, self._terms, strict=True)]
        own_terms = sample_width(term_order(group), dims)  # the first of a sample
        self._ahead = torch.cat(looks_ahead)[:own_terms].nonzero()[:, 0]
        self._own_terms = tuple(entry for entry in self._terms if not entry.ticks)
        self._own_width = sample_width(self._own_terms, dims)
        self.window_ticks = window_ticks([*groups.values()])
        self._default = torch.tensor(robot.default_pos_rad, device=device).float()

    def _seen_later(self) -> slice:
        """The columns of a sample between which all lie that are seen of older ticks than the present one."""
        seen = np.concatenate([one.index for one in self._of_block.values()])
        older = seen[seen >= self._width] % self._width
        return slice(older.min(), older.max() + 1) if len(older) else slice(0)

    def histories(self, num_envs: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Empty ones of actor (B, L, W) and critic (B, 5, V+3); V: what does not look ahead."""
        return (
            torch.zeros(num_envs, self._lags, self._width, device=self._device),
            torch.zeros(num_envs, CRITIC_LAGS, self._own_width + 3, device=self._device),
        )

    def push(self, state: EnvState, actor_sample: torch.Tensor, critic_sample: torch.Tensor) -> None:
        """Take in the samples (B, W) of every environment; every lag grows by one tick.

        Terms that are seen of the present tick alone, most of what looks ahead, are not kept any longer.
        """
        state.actor_history[:, 1:, self._older] = state.actor_history[:, :-1, self._older].clone()
        state.actor_history[:, 0] = actor_sample
        state.critic_history = torch.cat([critic_sample[:, None], state.critic_history[:, :-1]], dim=1)

    def restart(
        self, state: EnvState, env_ids: torch.Tensor, actor_sample: torch.Tensor, critic_sample: torch.Tensor
    ) -> None:
        """Begin the histories of ``env_ids`` (n,) anew: zeros, then the samples (n, W)."""
        for history, sample in ((state.actor_history, actor_sample), (state.critic_history, critic_sample)):
            history[env_ids] = 0.0
            history[env_ids, 0] = sample

    def sample(
        self,
        physics: PhysicsState,
        senses: Senses,
        gravity_b: torch.Tensor,
        last_action: torch.Tensor,
        phase: torch.Tensor,
        window: ReferenceWindow | None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the actor sample (n, W) and the exact critic sample (n, V+3) of n environments.

        ``senses``: what the robots' sensors make of ``physics``. ``gravity_b``: what their filters make of that.
        ``window``: the reference at :attr:`window_ticks`.
        """
        truth = senses_of(physics)
        upright = projected_gravity(truth.root_quat_wxyz)
        exact = self._sampled(self._own_terms, truth, upright, last_action, phase, None)
        measured = self._sampled(self._terms, senses, gravity_b, last_action, phase, window)
        lin_vel_b = quat_rotate_inverse(physics.root_quat_wxyz, physics.root_lin_vel_w)
        actor = torch.clamp(measured, -self._clip, self._clip)
        return actor, torch.cat([exact, LIN_VEL_SCALE * lin_vel_b], dim=1)

    def _sampled(
        self,
        terms: tuple[ObservationTerm, ...],
        senses: Senses,
        gravity_b: torch.Tensor,
        last_action: torch.Tensor,
        phase: torch.Tensor,
        window: ReferenceWindow | None,
    ) -> torch.Tensor:
        seen = ObservationInput(
            base_quat_wxyz=senses.root_quat_wxyz,
            base_ang_vel_b=senses.root_ang_vel_b,
            joint_pos_rad=senses.joint_pos_rad,
            joint_vel_rad_s=senses.joint_vel_rad_s,
            last_action=last_action,
            phase=phase[:, None] if phase.dim() == 1 else phase,
            default_pos_rad=self._default,
            filtered_gravity_b=gravity_b,
            reference=window,
        )
        return sample_terms(terms, seen).float()

    def ahead(self, newest: torch.Tensor) -> torch.Tensor:
        """The terms that look ahead on the reference (n, A) of the actor's samples (n, W) of the present tick."""
        return newest[:, self._ahead]

    def groups(self, history: torch.Tensor) -> dict[str, torch.Tensor]:
        """The observations (B, n) of actor and teacher, by name, laid out of the ``history`` (B, L, W)."""
        flat = history.flatten(1)
        return {name: layout.of(flat[:, self._index[name]]) for name, layout in self._of_block.items()}


def term_slices(group: ObservationGroup, num_joints: int) -> dict[str, slice]:
    """Where each term at each lag, ``term[lag]`` or ``term.of[lag]``, lies in the group's observation."""
    dims, first, found = term_dims(num_joints), 0, {}
    for entry in group.terms:
        for moment in entry.moments:
            found[f"{'.'.join(filter(None, (entry.term, entry.of)))}[{moment}]"] = slice(
                first, first + entry_size(entry, dims)
            )
            first += entry_size(entry, dims)
    return found
