"""What the world model foretells beside what happened: the same starts, the same targets or the same policy."""

from dataclasses import dataclass

import torch
from torch import Tensor

from core.rotations import quat_from_rotvec, quat_mul, quat_rotate
from train.mdp.tick import ReferenceTable
from train.world_model.context import context_of
from train.world_model.cost import terms_of
from train.world_model.imagination import Imagination
from train.world_model.model import WorldModel
from train.world_model.policy import BoundedResidual
from train.world_model.ring import Ring
from train.world_model.settings import OPEN_LOOP_STEPS
from train.world_model.starts import Starts
from train.world_model.state import Motion, error, unpack

SEED = 0
WINDOWS = 512
NEWEST_STEPS = 150
PARTS = ("place", "turn", "lin_vel", "ang_vel", "joint_pos", "joint_vel")


def constant_velocity(motion: Motion, seconds: float) -> Motion:
    """Where a robot would be if no velocity changed."""
    return motion._replace(
        pos_w=motion.pos_w + seconds * quat_rotate(motion.quat_wxyz, motion.lin_vel_b),
        quat_wxyz=quat_mul(motion.quat_wxyz, quat_from_rotvec(seconds * motion.ang_vel_b)),
        joint_pos_rad=motion.joint_pos_rad + seconds * motion.joint_vel_rad_s,
    )


@dataclass(frozen=True)
class Comparison:
    """Compares on the newest steps; what the network asked for counts as in imagination on both sides.

    Attributes:
        ring: what simulated robots did.
        imagination: plays the policy, with noise from ``generator``.
        starts: places robots as imagination does.
        table: the references.
        costs: weight by cost term.
        quiet: (N,) robots that act without noise.
        longest_episode: steps.
        generator: source of noise, and of which windows are compared.
    """

    ring: Ring
    imagination: Imagination
    starts: Starts
    table: ReferenceTable
    costs: dict[str, float]
    quiet: Tensor
    longest_episode: int
    generator: torch.Generator

    def figures(self, policy: BoundedResidual, model: WorldModel) -> dict[str, float]:
        """All of them, by name; each time of the same draws."""
        self.generator.manual_seed(SEED)
        return {**self.open_loop(model), **self.foretold(policy, model)}

    @torch.no_grad()
    def open_loop(self, model: WorldModel) -> dict[str, float]:
        """Median error of each part of the state after some steps of its own, over that of constant velocities."""
        longest = OPEN_LOOP_STEPS[-1]
        times, robots = self.ring.sample(WINDOWS, longest, NEWEST_STEPS, self.generator)
        first, states = self.ring.at(times[0], robots), self.ring.states(times, robots)
        segments, targets = self.ring.segments(times, robots), self.ring.targets(times[:-1], robots)
        before = self.ring.targets_before(times[0], robots, first.age, first.target)
        model.prepare()
        context = context_of(first.context, first.target.shape[1])
        played = model.play(unpack(states[0]), targets.unbind(0), before, context)
        figures = {}
        for steps in OPEN_LOOP_STEPS:
            whole = (segments[: steps + 1] == segments[:1]).all(dim=0)
            actual = unpack(states[steps])
            still = constant_velocity(unpack(states[0]), steps * model.dt_s)
            off, off_still = error(played[steps - 1], actual), error(still, actual)
            for name, mine, its in zip(PARTS, off, off_still, strict=True):
                median, usual = (values[whole].norm(dim=1).median() for values in (mine, its))
                figures[f"open_loop/{name}_{steps}"] = float(median / usual.clamp(min=1e-9))
        return figures

    @torch.no_grad()
    def foretold(self, policy: BoundedResidual, model: WorldModel) -> dict[str, float]:
        """Mean cost and survival of imagined rollouts, and of what the robots did from the same states on.

        Nothing where no clip, or no episode, is longer than a rollout.
        """
        steps = self.imagination.horizon
        times, drawn = self.ring.sample(WINDOWS, steps, NEWEST_STEPS, self.generator)
        robots = self.quiet[drawn % len(self.quiet)]
        first = self.ring.at(times[0], robots)
        # An episode that ends neither with its clip nor by its age is lost.
        room = (first.tick + steps < self.table.num_ticks[first.clip]) & (first.age + steps < self.longest_episode)
        if not room.any():
            return {}
        times, robots = times[:, room], robots[room]
        now, ahead = self.ring.at(times, robots), torch.arange(steps + 1, device=self.ring.device)[:, None]
        going_on = (now.age == now.age[:1] + ahead).float().cumprod(dim=0)
        exact = self.starts.of(times[0], robots)
        start = self.starts.anchored(exact)
        policy.prepare()
        model.prepare()
        imagined = self.imagination.play(policy, model, start, noisy=False)
        moved = start.motion.pos_w - exact.motion.pos_w
        real = [unpack(state) for state in torch.nan_to_num(now.state).unbind(0)]
        real = [motion._replace(pos_w=motion.pos_w + moved) for motion in real]
        rows = self.table.rows(start.clip.repeat(steps, 1).flatten(), (start.tick + ahead[1:]).flatten())
        happened = self.imagination.compare(real[1:], real[:-1], now.target[:-1], imagined.wish, rows, start.goal)
        figures = {}
        sides = {"imagined": (imagined.imagined, imagined.alive), "real": (happened, going_on[1:])}
        for name, (did, alive) in sides.items():
            cost = torch.stack([*terms_of(did, self.costs).values()]).sum(dim=0)
            figures[f"foretold/{name}_cost"] = float((cost * alive).sum() / alive.sum().clamp(min=1.0))
            figures[f"foretold/{name}_survival"] = float(alive[-1].mean())
        return figures
