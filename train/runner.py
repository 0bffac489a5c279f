"""The training loop: collect, learn, report, judge, save."""

import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from train.checkpoint import Checkpoints
from train.export import deployed
from train.interface import Evaluator, Policy, TrackingEnv, Trimmer
from train.learner.networks import Actor
from train.learner.ppo import Ppo
from train.nan_guard import NanGuard, NonFiniteError
from train.progress import Progress

CHECKPOINT_INTERVAL_S = 300.0


@dataclass(frozen=True)
class Budget:
    """When a run ends, and when it saves, judges and trims. ``minutes`` count over all lives of a resumed run.

    The actor is trimmed after ``trim_first`` iterations and each time that they have doubled since, as the policy's
    steps shrink alike: until the next trim there is as much learning as there was in all before.
    """

    iterations: int | None
    minutes: float | None
    checkpoint_every: int
    evaluate_every: int | None
    trim_first: int | None = None


@dataclass
class Best:
    """The latest judged weights that are as good as the best: up to ``limit``, the lowest score and its error.

    Falls of a hundred starts differ by chance more than weights that follow each other do, and later ones know more.
    """

    score: float = float("inf")
    limit: float = float("inf")
    iteration: int = 0
    figures: dict[str, float] = field(default_factory=dict)
    weights: dict[str, torch.Tensor] | None = None

    def after(
        self, iteration: int, figures: Mapping[str, float], weights: Callable[[], dict[str, torch.Tensor]]
    ) -> "Best":
        """The best when these were judged too."""
        score, lowest, limit = figures["score"], self.score, self.limit
        if score < lowest:
            lowest, limit = score, score + figures["score_error"]
        if not score <= limit < float("inf"):
            return self
        return Best(lowest, limit, iteration, dict(figures), weights())


class Runner:
    """One run.

    Args:
        env: the environment.
        learner: its actor and critic fit ``env``.
        budget: when to stop, save and judge.
        run_dir: existing folder of the run.
        document: resolved configuration, stored in checkpoints and dumps.
        progress: where rows go.
        evaluator: judge of the actor; None: the last weights are exported.
        trimmer: corrects the actor between iterations.
        should_stop: asked after each iteration; True saves and ends the run.
    """

    def __init__(
        self,
        env: TrackingEnv,
        learner: Ppo,
        budget: Budget,
        run_dir: Path,
        document: Mapping[str, Any],
        progress: Progress,
        evaluator: Evaluator | None = None,
        trimmer: Trimmer | None = None,
        should_stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self._env, self._learner, self._budget, self._run_dir = env, learner, budget, run_dir
        self._document, self._progress, self._evaluator, self._trimmer = dict(document), progress, evaluator, trimmer
        self._should_stop = should_stop
        self._checkpoints = Checkpoints(run_dir)
        self._guard = NanGuard(env)
        self._observations = env.reset()
        self.iteration, self.samples, self.wall_s, self.best = 0, 0, 0.0, Best()
        self.judged: dict[str, float] = {}
        self._save_s = 0.0
        self._last_save_s = self._iteration_start_s = 0.0

    def run(self) -> str:
        """Train until the budget is used (``completed``) or a stop is asked for (``stopped``).

        Raises:
            NonFiniteError: a number was NaN or infinite; a dump to replay lies in the run folder.
        """
        self._last_save_s = time.monotonic()
        while not (finished := self._is_finished()) and not self._should_stop():
            self._iteration_start_s = time.monotonic()
            row = self._collect_and_learn()
            self.iteration += 1
            self.samples += self._env.num_envs * self._learner.settings.horizon
            if self._is_due(self._budget.evaluate_every):
                row |= self._evaluate()
            if self._is_trim_due() and not self._is_finished():
                row |= self._trim()
            self._report(row)
            if self._is_due(self._budget.checkpoint_every) or self._is_save_overdue():
                self.save()
        self.save()
        self._progress.draw(at_once=True)
        return "completed" if finished else "stopped"

    def final_weights(self, *, judge: bool) -> dict[str, torch.Tensor]:
        """The weights to export: the best judged, else the last. ``judge``: judge the last ones too."""
        if judge and self.judged.get("iteration") != self.iteration:
            self._evaluate()
        return self.best.weights if self.best.weights is not None else self._weights()

    def actor_with(self, weights: Mapping[str, torch.Tensor]) -> Actor:
        """The actor with these weights, as deployed."""
        actor = deployed(self._learner.actor)
        actor.load_state_dict(dict(weights))
        return actor

    def policy(self) -> Policy:
        """The mean action of the averaged weights, as deployed."""
        actor = self.actor_with(self._learner.average.weights)

        @torch.no_grad()
        def act(observations: torch.Tensor) -> torch.Tensor:
            return actor(observations)

        return act

    def _collect_and_learn(self) -> dict[str, float]:
        self._guard.begin()
        try:
            collected = self._collect()
            learnt_from_s = time.monotonic()
            learnt = self._learner.update(self._observations)
        except NonFiniteError as error:
            raise self._dumped(error) from error
        self._env.finish_iteration()
        times = {
            "time/collect_s": learnt_from_s - self._iteration_start_s,
            "time/learn_s": time.monotonic() - learnt_from_s,
        }
        return collected | learnt | times

    def _collect(self) -> dict[str, float]:
        """Fill the storage; return the mean of each figure the environment logs, and the time of both sides."""
        logs: dict[str, list[float]] = defaultdict(list)
        times = {"time/act_s": 0.0, "time/step_s": 0.0}
        for _ in range(self._learner.settings.horizon):
            begun_s = time.monotonic()
            actions = self._learner.act(self._observations)
            acted_s = time.monotonic()
            result = self._guard.step(actions)
            times["time/act_s"] += acted_s - begun_s
            times["time/step_s"] += time.monotonic() - acted_s
            self._learner.record(result)
            self._observations = result.observations
            for name, value in result.log.items():
                logs[name].append(value)
            for name, value in zip(self._env.reward_names, result.rewards.mean(dim=0).tolist(), strict=True):
                logs[f"reward/{name}"].append(value)
        return {name: sum(values) / len(values) for name, values in logs.items()} | times

    def _report(self, row: dict[str, Any]) -> None:
        self.wall_s += time.monotonic() - self._iteration_start_s
        steps = self._env.num_envs * self._learner.settings.horizon
        row |= {
            "time/steps_per_s": steps / (row["time/collect_s"] + row["time/learn_s"]),
            "time/save_s": self._save_s,
            "time/wall_s": self.wall_s,
            "time/left_s": self._left_s(),
        }
        self._save_s = 0.0
        self._progress.report({"iteration": self.iteration, "samples": self.samples, **row})

    def _left_s(self) -> float:
        """Time until the first budget is used, at the mean pace so far."""
        by_time = float("inf") if self._budget.minutes is None else 60.0 * self._budget.minutes - self.wall_s
        if self._budget.iterations is None:
            return max(0.0, by_time)
        by_count = (self._budget.iterations - self.iteration) * self.wall_s / self.iteration
        return max(0.0, min(by_time, by_count))

    def _evaluate(self) -> dict[str, float]:
        """Judge the averaged weights and keep them if they are the best."""
        if self._evaluator is None:
            return {}
        begun_s = time.monotonic()
        figures = self._evaluator.evaluate(self.policy())
        self.judged = {"iteration": self.iteration, **figures}
        self.best = self.best.after(self.iteration, figures, self._weights)
        row = {f"evaluation/{name}": value for name, value in figures.items()} | self._env.figures()
        return row | {"time/evaluate_s": time.monotonic() - begun_s}

    def _trim(self) -> dict[str, float]:
        """Correct the actor with the averaged weights. What learns from now on learns beside the correction."""
        if self._trimmer is None:
            return {}
        begun_s = time.monotonic()
        figures = self._trimmer.trim(self.policy())
        return {f"trim/{name}": value for name, value in figures.items()} | {"time/trim_s": time.monotonic() - begun_s}

    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: value.clone() for name, value in self._learner.average.weights.items()}

    def _is_finished(self) -> bool:
        minutes, iterations = self._budget.minutes, self._budget.iterations
        out_of_time = minutes is not None and self.wall_s >= 60.0 * minutes
        return out_of_time or (iterations is not None and self.iteration >= iterations)

    def _is_due(self, every: int | None) -> bool:
        return every is not None and self.iteration % every == 0

    def _is_trim_due(self) -> bool:
        first = self._budget.trim_first
        return first is not None and self._is_due(first) and (self.iteration // first).bit_count() == 1

    def _is_save_overdue(self) -> bool:
        """Whether another iteration like this one would end after the longest time between checkpoints."""
        now = time.monotonic()
        return now - self._last_save_s + (now - self._iteration_start_s) >= CHECKPOINT_INTERVAL_S

    def save(self) -> None:
        """Write a checkpoint and refresh the pictures. Its time is in the next row: ``time/save_s``."""
        begun_s = time.monotonic()
        self._checkpoints.save(self.iteration, self.state_dict())
        self._progress.draw()
        self._last_save_s = time.monotonic()
        self._save_s += self._last_save_s - begun_s

    def _dumped(self, error: NonFiniteError) -> NonFiniteError:
        """Leave a dump of the failed iteration; return the error with the dump's place in it."""
        path = self._run_dir / f"nan_dump_{self.iteration + 1:08d}.pt"
        extra = {"config": self._document, "iteration": self.iteration + 1, "learner": self._learner.state_dict()}
        self._guard.dump(path, error, extra)
        self._progress.draw(at_once=True)
        return NonFiniteError(f"iteration {self.iteration + 1}: {error.group}", error.env_ids, dump=path)

    def state_dict(self) -> dict[str, Any]:
        """Everything the run is."""
        return {
            "config": self._document,
            "iteration": self.iteration,
            "samples": self.samples,
            "wall_s": self.wall_s,
            "best": vars(self.best),
            "torch": str(torch.__version__),
            "learner": self._learner.state_dict(),
            "environment": self._env.state_dict(),
            "observations": dict(self._observations),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue where :meth:`state_dict` was taken."""
        self.iteration, self.samples, self.wall_s = state["iteration"], state["samples"], state["wall_s"]
        self.best = Best(**state["best"])
        self._learner.load_state_dict(state["learner"])
        self._env.load_state_dict(state["environment"])
        self._observations = state["observations"]
