"""Takes the mean error of nominal robots away: offsets of the targets, by how bodies answer to offsets.

Iterative learning control (Bristow, Tharayil and Alleyne, IEEE Control Systems, 2006) of the actor as it is, with a
measured plant: robots play the whole clip, each with its own small smooth offsets; regression tells how far an offset
moves each body up to a second later, and Gauss-Newton finds the offsets that bring the bodies to the reference. PPO
alone finds them slowly, as they last for tenths of a second and its noise for a tick.
"""

from dataclasses import replace

import numpy as np
import torch
from scipy.linalg import solveh_banded

from motion.reference import Reference
from robot.robot import Robot
from train.interface import Policy
from train.mdp.evaluator import ERROR_WEIGHT, FALL_COST, whole_clip
from train.mdp.factory import build_environment
from train.mdp.settings import EnvironmentSettings, StartSettings
from train.phase_basis import num_knots, phase_hats
from train.priors.module import BaseAction

PROBE_STD = 0.06  # raw actions
START_NOISE_RAD = 0.005
EVERY_TICKS, MEMORY_KNOTS = 5, 6
RIDGE = 0.05  # relative to the variance of the probes
ROOT_WEIGHT = 1.5  # of the root's error, beside those of bodies relative to it
PRICE_M2 = 6e-4  # of a squared raw offset, in squared errors
SHARES = (0.0, 0.25, 0.5)  # of the whole step, which is as far as the linear answer holds; 1 makes robots fall


class Trim:
    """Moves the targets of a base action so that nominal robots come closer to the reference.

    Args:
        base: of the actor that is trimmed.
        settings: of the training environment.
        robot, reference: what is tracked.
        num_envs: robots that play at once; some hundreds tell enough.
        seed: of every trim.
        threads: worker threads of the physics.
    """

    def __init__(
        self,
        base: BaseAction,
        settings: EnvironmentSettings,
        robot: Robot,
        reference: Reference,
        *,
        num_envs: int,
        seed: int,
        threads: int,
    ) -> None:
        self._base, self._robot, self._reference = base, robot, reference
        self._num_envs, self._seed, self._threads = num_envs, seed, threads
        start = StartSettings(first_frame=1.0, joint_noise_rad=START_NOISE_RAD)
        self._settings = replace(whole_clip(settings, reference)["nominal"], start=start, events={})
        self._knots = num_knots(reference.duration_s)
        self._ticks = range(EVERY_TICKS - 1, reference.num_ticks - 1, EVERY_TICKS)  # after the last one all is reset

    def trim(self, act: Policy) -> dict[str, float]:
        """Move the targets for the actor ``act``; return the errors before and after, and the share of the step.

        Nothing moves where half of the robots fall with their probes, or where no step makes the errors smaller.
        """
        generator = torch.Generator().manual_seed(self._seed)
        half = PROBE_STD * torch.randn(self._num_envs // 2, self._knots, self._robot.num_joints, generator=generator)
        probes = torch.cat([half, -half])
        error_m, alive = self._play(act, probes, self._seed)
        if float(alive.float().mean()) < 0.5:
            return {"share": 0.0}
        phases = torch.tensor([tick / self._reference.num_ticks for tick in self._ticks])
        step = whole_step(probes[alive], error_m[alive], phases)
        shares = torch.tensor(SHARES)
        figures = self._tried(act, shares[:, None, None] * step)
        best = int(figures["score"].argmin())
        self._base.move_targets(SHARES[best] * step)
        names = ("empbpe_mm", "eg_mpbpe_mm")
        before, after = ({name: float(figures[name][i]) for name in names} for i in (0, best))
        return {"share": SHARES[best], **after, **{f"{name}_before": value for name, value in before.items()}}

    def _tried(self, act: Policy, steps: torch.Tensor) -> dict[str, torch.Tensor]:
        """Figures (S,) of robots that play with steps (S, K, J), and their score as evaluations have it."""
        each = max(1, self._num_envs // (2 * len(SHARES)))
        error_m, alive = self._play(act, steps.repeat_interleave(each, 0), self._seed + 1)
        relative_m = error_m - error_m[:, :, :1]
        body, whole, alive = (
            values.unflatten(0, (len(steps), each)).mean(dim=1)
            for values in (_mean_mm(relative_m), _mean_mm(error_m), alive.float())
        )
        score = body + ERROR_WEIGHT * whole + FALL_COST * (1.0 - alive)
        return {"empbpe_mm": body, "eg_mpbpe_mm": whole, "score": score}

    def _play(self, act: Policy, offsets: torch.Tensor, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Errors (B, T, bodies, 3) of all bodies in metres, the root first, and who never falls (B,)."""
        env = build_environment(
            self._settings, self._robot, self._reference,
            num_envs=len(offsets), seed=seed, threads=self._threads,
        )  # fmt: skip
        observations, alive, errors = env.reset()["actor"], torch.ones(len(offsets), dtype=torch.bool), []
        for tick in range(self._reference.num_ticks - 1):
            hats = phase_hats(self._base.phase(observations), self._knots)
            result = env.step(act(observations) + torch.einsum("bk,bkj->bj", hats, offsets))
            observations = result.observations["actor"]
            alive &= ~result.terminated
            if tick in self._ticks:
                errors.append(env.state.position_error_m)
        return torch.stack(errors, dim=1), alive


def whole_step(probes: torch.Tensor, error_m: torch.Tensor, phases: torch.Tensor) -> torch.Tensor:
    """Offsets (K, J) that would take away the mean error if bodies answered to all offsets as they do to small ones.

    Args:
        probes: (S, K, J) offsets that robots played with, raw actions at knots spread evenly over the clip.
        error_m: (S, T, bodies, 3) their errors, the root's first.
        phases: (T,) where in the clip, 0 to 1.
    """
    _, knots, joints = probes.shape
    band = np.zeros(((MEMORY_KNOTS + 1) * joints, knots * joints))  # of the normal matrix: row d is its d-th diagonal
    band[0] = PRICE_M2
    pull = np.zeros(knots * joints)
    root_m = error_m[:, :, :1]
    wanted = torch.cat([error_m - root_m, ROOT_WEIGHT * root_m], dim=2).flatten(2).double()
    for tick, phase in enumerate(phases.tolist()):
        last = min(knots - 1, int(phase * (knots - 1)) + 1)
        columns = slice(max(0, last - MEMORY_KNOTS) * joints, (last + 1) * joints)
        mean, answer = _answer(probes.flatten(1)[:, columns].double(), wanted[:, tick])
        pull[columns] -= (answer @ mean).numpy() / len(phases)
        square = (answer @ answer.T).numpy() / len(phases)
        for away in range(len(square)):
            band[away, columns.start : columns.stop - away] += square.diagonal(away)
    return torch.from_numpy(solveh_banded(band, pull, lower=True)).view(knots, joints).float()


def _answer(probes: torch.Tensor, errors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Mean (E,) of errors (S, E), and by ridge regression what a unit of each of probes (S, P) adds: (P, E)."""
    mean, probes = errors.mean(dim=0), probes - probes.mean(dim=0)
    normal = probes.T @ probes / len(probes) + RIDGE * PROBE_STD**2 * torch.eye(probes.shape[1], dtype=torch.float64)
    return mean, torch.linalg.solve(normal, probes.T @ (errors - mean) / len(probes))


def _mean_mm(error_m: torch.Tensor) -> torch.Tensor:
    """Mean distance (B,) of errors (B, T, bodies, 3), in mm."""
    return 1e3 * error_m.norm(dim=-1).mean(dim=(1, 2))
