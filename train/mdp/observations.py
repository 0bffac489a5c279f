"""What actor and critic see (PBHC Table 5): the shared terms, batched, with noise and history."""

from collections.abc import Mapping

import torch

from core.rotations import quat_conjugate, quat_rotate, quat_rotate_inverse, yaw_quat
from policy.layouts import pbhc_actor_group
from policy.observation import gather_index, num_lags, sample_clip, sample_terms, sample_width, term_dims, term_order
from policy.terms import ObservationInput
from robot.robot import Robot
from train.mdp.tick import Bodies
from train.simulation.domain import Domain
from train.simulation.simulator import PhysicsState

LIN_VEL_SCALE = 2.0
DOMAIN_SCALE = 10.0
DELAY_SCALE = 25.0


class Observations:
    """Samples the observation terms of a batch and keeps their histories, newest first.

    Args:
        robot: the robot.
        num_envs: B.
        noise: term name → half width of the uniform noise on the actor's samples, before scaling.
        older_lags: see :func:`policy.observation.pbhc_actor_group`; the critic, who sees what is hidden, has none.
    """

    def __init__(
        self,
        robot: Robot,
        num_envs: int,
        noise: Mapping[str, float],
        older_lags: tuple[int, ...] = (),
    ) -> None:
        self.group = pbhc_actor_group(older_lags=older_lags)
        dims = term_dims(robot.num_joints)
        self._terms = term_order(self.group)
        self._index = torch.as_tensor(gather_index(self.group, dims))
        self._clip = torch.as_tensor(sample_clip(self._terms, dims)).float()
        width = sample_width(self._terms, dims)
        self._noise = torch.cat([torch.full((dims[t.term],), noise.get(t.term, 0.0) * t.scale) for t in self._terms])
        self._default = torch.tensor(robot.default_pos_rad).float()
        self.actor_history = torch.zeros(num_envs, num_lags(self.group), width)
        self.critic_history = torch.zeros(num_envs, num_lags(pbhc_actor_group()), width + 3)

    def push(self, actor_sample: torch.Tensor, critic_sample: torch.Tensor) -> None:
        """Take in the samples (B, W) of every environment; every lag grows by one tick."""
        self.actor_history = torch.cat([actor_sample[:, None], self.actor_history[:, :-1]], dim=1)
        self.critic_history = torch.cat([critic_sample[:, None], self.critic_history[:, :-1]], dim=1)

    def restart(self, env_ids: torch.Tensor, actor_sample: torch.Tensor, critic_sample: torch.Tensor) -> None:
        """Begin the histories of ``env_ids`` (n,) anew: zeros, then the samples (n, W)."""
        for history, sample in ((self.actor_history, actor_sample), (self.critic_history, critic_sample)):
            history[env_ids] = 0.0
            history[env_ids, 0] = sample

    def sample(
        self,
        physics: PhysicsState,
        last_action: torch.Tensor,
        phase: torch.Tensor,
        *,
        noise_scale: float,
        generator: torch.Generator,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the noisy actor sample (n, W) and the exact critic sample (n, W+3) of n environments.

        The noise is drawn from ``generator``.
        """
        terms = ObservationInput(
            base_quat_wxyz=physics.root_quat_wxyz,
            base_ang_vel_b=physics.root_ang_vel_b,
            joint_pos_rad=physics.joint_pos_rad,
            joint_vel_rad_s=physics.joint_vel_rad_s,
            last_action=last_action,
            phase=phase[:, None] if phase.dim() == 1 else phase,
            default_pos_rad=self._default,
        )
        exact = sample_terms(self._terms, terms).float()
        noise = (2.0 * torch.rand(exact.shape, generator=generator) - 1.0) * (self._noise * noise_scale)
        lin_vel_b = quat_rotate_inverse(physics.root_quat_wxyz, physics.root_lin_vel_w)
        actor = torch.clamp(exact + noise, -self._clip, self._clip)
        return actor, torch.cat([exact, LIN_VEL_SCALE * lin_vel_b], dim=1)

    def actor(self) -> torch.Tensor:
        """The actor's observation (B, 380), and the older ticks after it."""
        return self.actor_history.flatten(1).gather(1, self._index.expand(len(self.actor_history), -1))


def reference_view(physics: PhysicsState, bodies: Bodies, target_pos_w: torch.Tensor) -> torch.Tensor:
    """Reference body positions relative to the base, and to the bodies, in the heading frame: (n, 2·27·3)."""
    heading = quat_conjugate(yaw_quat(physics.root_quat_wxyz))[:, None]
    relative = quat_rotate(heading, target_pos_w - physics.root_pos_w[:, None])
    difference = quat_rotate(heading, target_pos_w - bodies.pos_w)
    return torch.cat([relative.flatten(1), difference.flatten(1)], dim=1)


def domain_view(domain: Domain, delay_s: torch.Tensor) -> torch.Tensor:
    """The randomised parameters as the critic sees them, around zero and of order one: (B, 3+22+23+23+1+1)."""
    return torch.cat(
        [
            domain.com_offset_m * DOMAIN_SCALE,
            (domain.mass_scale - 1.0) * DOMAIN_SCALE,
            (domain.kp_scale - 1.0) * DOMAIN_SCALE,
            (domain.kd_scale - 1.0) * DOMAIN_SCALE,
            (domain.friction[:, None] - 1.0),
            delay_s[:, None] * DELAY_SCALE,
        ],
        dim=1,
    )
