"""A small environment with the learner's interface: point masses that follow a circle."""

import math

import numpy as np
import torch

from train.interface import StepResult

DT = 0.05
EPISODE = 40
LAYOUT = {
    "actor": {"error": slice(0, 2), "velocity": slice(2, 4), "phase": slice(4, 7)},
    "critic": {"actor": slice(0, 7), "position": slice(7, 9), "phase": slice(9, 12)},
}


class PointMassEnv:
    """B masses in the plane; the action is an acceleration. ``poison``: (step count, environment) that becomes NaN."""

    num_actions, device = 2, torch.device("cpu")
    reward_names = ("position", "effort")

    def __init__(self, num_envs=16, seed=0, poison=None):
        self.num_envs, self.poison, self.layout = num_envs, poison, LAYOUT
        self.generator = torch.Generator().manual_seed(seed)
        self.pos, self.vel = torch.zeros(num_envs, 2), torch.zeros(num_envs, 2)
        self.tick, self.steps = torch.zeros(num_envs, dtype=torch.long), 0
        self.finished_iterations = 0

    def _target(self):
        angle = 2.0 * math.pi * self.tick / EPISODE
        return torch.stack([angle.cos(), angle.sin()], dim=1)

    def _draw(self, rows):
        self.tick[rows] = 0
        start = torch.tensor([1.0, 0.0]) + 0.2 * torch.randn(len(rows), 2, generator=self.generator)
        self.pos[rows], self.vel[rows] = start, torch.tensor([0.0, 3.0])

    def _critic(self):
        early_middle_late = (1.0 - (2.0 * self.tick[:, None] / EPISODE - torch.arange(3)).abs()).clamp(min=0.0)
        return torch.cat([self._actor(), self.pos, early_middle_late], dim=1)

    def _actor(self):
        phase = 2.0 * math.pi * (self.tick / EPISODE)[:, None]
        return torch.cat([self._target() - self.pos, self.vel, phase.cos(), phase.sin(), torch.ones_like(phase)], dim=1)

    def _observe(self):
        return {"actor": self._actor(), "critic": self._critic()}

    def reset(self):
        self._draw(torch.arange(self.num_envs))
        return self._observe()

    def step(self, actions):
        self.steps += 1
        self.vel = self.vel + 4.0 * DT * actions.clamp(-5, 5)
        self.pos = self.pos + DT * self.vel
        if self.poison and self.steps == self.poison[0]:
            self.pos[self.poison[1], 0] = math.nan
        self.tick += 1
        error = (self._target() - self.pos).norm(dim=1)
        terminated = error > 1.5
        timed_out = (self.tick >= EPISODE) & ~terminated
        rewards = torch.stack([torch.exp(-4.0 * error), -0.01 * actions.square().sum(dim=1)], dim=1) * DT
        final = self._critic()[timed_out]
        log = {"eg_mpbpe_mm": 1e3 * float(error.mean()), "episode_length_ratio": float((self.tick / EPISODE).mean())}
        self._draw((terminated | timed_out).nonzero()[:, 0])
        return StepResult(self._observe(), rewards, terminated, timed_out, final, log)

    def figures(self):
        return {}

    def finish_iteration(self):
        self.finished_iterations += 1

    def state_dict(self):
        return {
            "pos": self.pos.numpy().astype(np.float64),
            "vel": self.vel,
            "tick": self.tick,
            "steps": self.steps,
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state):
        self.pos = torch.from_numpy(state["pos"]).float()
        self.vel, self.tick, self.steps = state["vel"].clone(), state["tick"].clone(), state["steps"]
        self.generator.set_state(state["generator"])
