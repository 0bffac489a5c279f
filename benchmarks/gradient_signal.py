#!/usr/bin/env -S python3 -P
"""How much of a run's policy gradient is signal, for several decays λ of the advantages.

Holds the actor of the newest checkpoint still, goes on with its robots and takes a gradient from each of many batches.
"signal": squared mean gradient over mean squared gradient, 1 without noise. "aim": cosine between the gradient of one
batch and the mean gradient by Monte Carlo returns; a step of given length brings that share of what it could. Aims
share the noise of that mean: compare them within one call. Every number of a gradient is scaled as Adam would.
Of a run with pairs (learner.exploration) "pairs" are advantages from all robots' differences to their twins, the rest
is of the half that is nobody's twin.
"""

import sys
from argparse import RawDescriptionHelpFormatter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from core.arguments import ArgumentParser
from core.command import guarded
from core.errors import InputError
from motion.reference import build_reference
from train.folder import FEASIBLE_FILE
from train.learner.build import build_learner, exploration_of
from train.learner.gae import advantages_per_head
from train.learner.gaussian import log_prob
from train.learner.ppo import Ppo
from train.learner.storage import Minibatch
from train.mdp.tracking import CONTROL_PERIOD_S
from train.priors.build import prior_of
from train.session import environment_of
from train.setup import Setup, resumed_setup

BATCH_STEPS = 96  # or a little more, whole horizons; Monte Carlo returns go over all of them
MONTE_CARLO = "Monte Carlo"
SAMPLES_AT_ONCE = 12288


def signal_and_aim(gradients: Tensor, reference: Tensor) -> tuple[float, float]:
    """Of gradients (N, P), one a batch, beside reference gradients (N, P) of the same batches.

    Products are taken between different batches only, whose noise is independent: no estimate is biased by noise.
    """

    def product(a: Tensor, b: Tensor) -> float:
        pairs = len(a) * (len(a) - 1)
        return float((a.sum(dim=0) @ b.sum(dim=0) - (a * b).sum()) / pairs)

    mean_square = float(gradients.square().sum(dim=1).mean())
    length = max(product(reference, reference), 1e-30) ** 0.5
    return product(gradients, gradients) / mean_square, product(gradients, reference) / mean_square**0.5 / length


class Batches:
    """Rolls a still actor out, and takes gradients of its network."""

    def __init__(self, setup: Setup) -> None:
        assert setup.state is not None
        config = setup.config
        torch.set_num_threads(config.threads)
        self.env = environment_of(setup)
        base = prior_of(
            config, setup.robot, build_reference(setup.clip, setup.robot, CONTROL_PERIOD_S),
            fit=False, stored=setup.run_dir / FEASIBLE_FILE, progress=partial(print, file=sys.stderr),
        )  # fmt: skip
        self.horizon, self.exploration = config.learner.horizon, exploration_of(config.learner.exploration)
        self.steps = self.horizon * -(-BATCH_STEPS // self.horizon)
        self.learner: Ppo = build_learner(
            replace(config, learner=replace(config.learner, horizon=self.steps)), self.env, base
        )
        self.learner.load_state_dict(setup.state["learner"])
        self.env.load_state_dict(setup.state["environment"])
        self.observations = setup.state["observations"]
        self.weights = [p for n, p in self.learner.actor.named_parameters() if n.startswith("mlp.")]
        moments = [self.learner.optimizer.state[weight]["exp_avg_sq"] for weight in self.weights]
        self.scale = torch.cat([(moment.sqrt() + 1e-8).rsqrt().flatten() for moment in moments])

    def gradients(self, lams: Sequence[float]) -> dict[str, Tensor]:
        """One more batch's gradients (P,) by the name of their advantages; ``MONTE_CARLO`` is among them."""
        for _ in range(self.steps):
            result = self.env.step(self.learner.act(self.observations))
            self.learner.record(result)
            self.observations = result.observations
        advantages = {f"{lam:g}": self._alone(self._advantages(lam, self.horizon)) for lam in lams}
        if (steps := self.exploration.window) is not None:
            advantages |= {f"{lam:g}, pairs": self.exploration.advantages(self._advantages(lam, steps)) for lam in lams}
        advantages[MONTE_CARLO] = self._alone(self._advantages(1.0, self.steps))
        self.learner.forget()
        gradients = self._gradients(torch.stack([a.flatten() - a.mean() for a in advantages.values()]))
        return dict(zip(advantages, gradients, strict=True))

    def _alone(self, advantages: Tensor) -> Tensor:
        """Without those of twins, which go back to their robots in between."""
        if self.exploration.window is not None:
            advantages[:, advantages.shape[1] // 2 :] = 0.0
        return advantages

    @torch.no_grad()
    def _advantages(self, lam: float, window: int) -> Tensor:
        s, last_values = self.learner.storage, self.learner.critic(self.observations["critic"])
        return advantages_per_head(
            s["rewards"], s["values"], last_values, s["done"], gamma=self.learner.settings.gamma, lam=lam, window=window
        ).sum(dim=-1)

    def _gradients(self, advantages: Tensor) -> Tensor:
        s, actor = self.learner.storage, self.learner.actor
        seen = Minibatch({name: column.flatten(0, 1) for name, column in s.columns.items()})
        actions = seen["actions"]
        total = torch.zeros(len(advantages), len(self.scale))
        for rows in torch.arange(len(actions)).split(SAMPLES_AT_ONCE):
            mean = actor.mean(**{name: column[rows] for name, column in seen.of("actor").items()})
            density = log_prob(actions[rows], mean, actor.log_std.detach())
            weights = advantages[:, rows] / len(actions)
            parts = torch.autograd.grad(density, self.weights, weights, is_grads_batched=True)
            total += torch.cat([part.flatten(1) for part in parts], dim=1)
        return total * self.scale


@guarded
def main(arguments: list[str]) -> int:
    """Measure and print. Returns the exit code."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("run_dir", type=Path, metavar="RUN_DIR", help="a run with a checkpoint")
    parser.add_argument("--lam", type=float, nargs="+", default=[0.95, 0.85, 0.5, 0.0], metavar="λ")
    parser.add_argument("--batches", type=int, default=12, metavar="N", help=f"of {BATCH_STEPS} steps each")
    options = parser.parse_args(arguments)
    if not all(0.0 <= lam <= 1.0 for lam in options.lam):
        raise InputError("out of range", where="--lam", got=options.lam, expected="0 to 1")
    if options.batches < 2:
        raise InputError("too few", where="--batches", got=options.batches, expected="2 or more")
    batches = Batches(resumed_setup(options.run_dir, []))
    seen = []
    for number in range(options.batches):
        seen.append(batches.gradients(options.lam))
        print(f"batch {number + 1} of {options.batches}", file=sys.stderr, flush=True)
    gradients = {name: torch.stack([batch[name] for batch in seen]) for name in seen[0]}
    print(f"{'λ':14} {'signal':>8} {'aim':>8}")
    for name in gradients:
        signal, aim = signal_and_aim(gradients[name], gradients[MONTE_CARLO])
        print(f"{name:14} {signal:8.3f} {aim:8.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
