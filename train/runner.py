"""The training loop: collect and learn. What else happens in between is hooks (:mod:`train.hooks`)."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import torch

from train.figures import Figures
from train.hooks import Hook
from train.interface import Environment, Policy
from train.learner.learner import Learner
from train.nan_guard import NanGuard, NonFiniteError

Outcome = Literal["completed", "stopped"]


class Runner:
    """One run.

    Args:
        env: the environment.
        learner: its actor and critic fit ``env``.
        run_dir: existing folder of the run.
        document: resolved configuration, stored in checkpoints and dumps.
        hooks: called in this order, at the end in the reverse one; one of them sets :attr:`outcome`, which ends the
            run.
        lineage: where the first weights came from.
    """

    def __init__(
        self,
        env: Environment,
        learner: Learner,
        run_dir: Path,
        document: Mapping[str, Any],
        hooks: Sequence[Hook],
        lineage: Mapping[str, Any] | None = None,
    ) -> None:
        self.env, self.learner, self.hooks, self.lineage = env, learner, hooks, lineage
        self._run_dir, self._document = run_dir, dict(document)
        self._guard = NanGuard(env)
        self.observations = env.reset()
        self.iteration, self.samples, self.wall_s = 0, 0, 0.0
        self.outcome: Outcome | None = None
        self.iteration_start_s = 0.0

    @property
    def steps_per_iteration(self) -> int:
        """Environment steps of all robots together."""
        return self.env.num_envs * self.learner.horizon

    def run(self) -> Outcome:
        """Train until a hook sets the outcome: the budget is used (``completed``), or a stop was asked for.

        Raises:
            NonFiniteError: a number was NaN or infinite; a dump to replay lies in the run folder.
        """
        for hook in self.hooks:
            hook.before_run(self)
        while self.outcome is None:
            self.iteration_start_s = time.monotonic()
            row = self._collect_and_learn()
            self.iteration += 1
            self.samples += self.steps_per_iteration
            for hook in self.hooks:
                hook.after_iteration(self, row)
        for hook in reversed(self.hooks):
            hook.after_run(self)
        return self.outcome

    def policy(self, weights: Mapping[str, torch.Tensor]) -> Policy:
        """The mean action of the learner's actor with such weights, as deployed."""
        actor = self.learner.actor_with(weights)

        @torch.no_grad()
        def act(observations: torch.Tensor) -> torch.Tensor:
            return actor(observations.to(actor.log_std.device)).to(observations.device)

        return act

    def _collect_and_learn(self) -> dict[str, Any]:
        self._guard.begin()
        try:
            collected = self._collect()
            learnt_from_s = time.monotonic()
            learnt = self.learner.update(self.observations)
        except NonFiniteError as error:
            raise self._dumped(error) from error
        self.env.finish_iteration()
        times = {
            "time/collect_s": learnt_from_s - self.iteration_start_s,
            "time/learn_s": time.monotonic() - learnt_from_s,
        }
        return collected | learnt | times

    def _collect(self) -> dict[str, float]:
        """Let the learner act for its horizon; return the mean of each figure the environment logs, and times."""
        figures, times, rewards = Figures(), {"time/act_s": 0.0, "time/step_s": 0.0}, []
        for _ in range(self.learner.horizon):
            begun_s = time.monotonic()
            actions = self.learner.act(self.observations)
            acted_s = time.monotonic()
            result = self._guard.step(actions)
            times["time/act_s"] += acted_s - begun_s
            times["time/step_s"] += time.monotonic() - acted_s
            self.learner.record(result)
            self.observations = result.observations
            figures.add(result.log)
            rewards.append(result.rewards.mean(dim=0))
        for step in torch.stack(rewards).cpu():
            figures.add({f"reward/{name}": float(value) for name, value in zip(self.env.reward_names, step)})
        return figures.means() | times

    def _dumped(self, error: NonFiniteError) -> NonFiniteError:
        """Leave a dump of the failed iteration; return the error with the dump's place in it."""
        path = self._run_dir / f"nan_dump_{self.iteration + 1:08d}.pt"
        extra = {"config": self._document, "iteration": self.iteration + 1, "learner": self.learner.state_dict()}
        self._guard.dump(path, error, extra)
        for hook in self.hooks:
            hook.after_failure(self)
        return NonFiniteError(f"iteration {self.iteration + 1}: {error.group}", error.env_ids, dump=path)

    def state_dict(self) -> dict[str, Any]:
        """Everything the run is."""
        return {
            "config": self._document,
            "iteration": self.iteration,
            "samples": self.samples,
            "wall_s": self.wall_s,
            "lineage": self.lineage,
            "torch": str(torch.__version__),
            "hooks": {type(hook).__name__: hook.state_dict() for hook in self.hooks},
            "learner": self.learner.state_dict(),
            "environment": self.env.state_dict(),
            "observations": dict(self.observations),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where :meth:`state_dict` was taken. A hook that the earlier life lacked begins anew."""
        self.iteration, self.samples, self.wall_s = state["iteration"], state["samples"], state["wall_s"]
        self.lineage = state["lineage"]
        for hook in self.hooks:
            hook.load_state_dict(state["hooks"].get(type(hook).__name__, {}))
        self.learner.load_state_dict(state["learner"])
        self.env.load_state_dict(state["environment"])
        self.observations = {name: values.to(self.env.device) for name, values in state["observations"].items()}
