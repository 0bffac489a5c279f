#!/usr/bin/env -S python3 -P
"""How fast training is on this machine, next to the physics that it cannot do without.

Three speeds, in environment steps (control periods of one robot) per second, measured in turns so that whatever else
the machine does weighs on all alike, of which the medians count:

- physics: MuJoCo's threaded rollout alone, on the models, states and inputs that the stepping met;
- stepping: the environment with small random actions around what an untrained actor does;
- loop: what train/run.py does in an iteration: collect and learn.

With --world-model it times rounds of the tracker's learner instead, in one process, so that each part has a time of its
own: simulated steps, updates of the world model, updates of policy and critic.
"""

import os
import sys
import tempfile
import time
from argparse import RawDescriptionHelpFormatter
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

# As in train/run.py: before torch is loaded.
os.environ.setdefault("GOMP_SPINCOUNT", "2000")

import numpy as np
import torch
from mujoco.rollout import Rollout

from core.arguments import ArgumentParser
from core.command import guarded
from core.errors import InputError
from core.files import check_output_file, write_json
from core.structured import at_least
from robot.kinematics import Kinematics
from train import interface
from train.config import compose_document
from train.hooks import Budget, Reporting, Stopping
from train.learner.build import build_learner
from train.learner.ppo import Ppo
from train.mdp.critic import Critic
from train.mdp.observations import Observations
from train.mdp.paired import PairedEnv
from train.mdp.reward_sum import RewardSum
from train.mdp.tracking import TrackingEnv
from train.nan_guard import NanGuard
from train.progress import TrainingProgress
from train.runner import Runner
from train.session import environment_of
from train.setup import Setup, new_setup
from train.world_model import critic
from train.world_model.build import build_world_model_learner
from train.world_model.fitting import ModelFitting
from train.world_model.imagination import Imagination
from train.world_model.learner import WorldModelLearner
from train.world_model.policy_learning import PolicyLearning
from train.world_model.starts import Starts

BRIEF = [f"world_model.fitting.warm_up_{name}" for name in ("steps=40000", "single=20", "window=20")]
ACTION_NOISE = 0.1  # standard deviation of the random actions, raw

PHASES: dict[str, tuple[tuple[type, str], ...]] = {
    "physics": ((Rollout, "rollout"),),
    "kinematics": ((Kinematics, "forward"),),
    "rewards": ((RewardSum, "of"),),
    "observations": (
        (TrackingEnv, "_observe"),
        (Critic, "view"),
        (Observations, "sample"),
        (Observations, "push"),
        (Observations, "restart"),
    ),
    "rest of stepping": ((TrackingEnv, "step"), (PairedEnv, "step")),
    "learner: act": ((Ppo, "act"), (Ppo, "record")),
    "learner: update": ((Ppo, "update"),),
    "NaN guard": ((NanGuard, "begin"), (NanGuard, "step")),
}


ROUND_PARTS: dict[str, tuple[tuple[type, str], ...]] = {
    "robots act": ((WorldModelLearner, "act"), (WorldModelLearner, "record")),
    "robots step": ((TrackingEnv, "step"),),
    "model updates": ((ModelFitting, "update"),),
    "starts": ((Starts, "draw"),),
    "imagination": ((Imagination, "play"),),
    "cost and gradient": ((PolicyLearning, "_update"),),
    "critic": ((critic.Critic, "learn"),),
}


@contextmanager
def replaced(owner: type, name: str, make: Callable[[Callable], Callable]) -> Iterator[None]:
    """Let ``make(method)`` stand in for a method for a while."""
    original = getattr(owner, name)
    setattr(owner, name, make(original))
    try:
        yield
    finally:
        setattr(owner, name, original)


class Stopwatch:
    """Time in each phase of the training loop, without the phases inside it."""

    def __init__(self, phases: Mapping[str, tuple[tuple[type, str], ...]] = PHASES) -> None:
        self._phases = phases
        self.seconds: dict[str, float] = defaultdict(float)
        self.running = False
        self._inner_s: list[float] = []

    @contextmanager
    def on_phases(self) -> Iterator[None]:
        """Time the phases' methods, while :attr:`running`."""
        with ExitStack() as stack:
            for phase, methods in self._phases.items():
                for owner, name in methods:
                    stack.enter_context(replaced(owner, name, partial(self._timed, phase)))
            yield

    def _timed(self, phase: str, method: Callable) -> Callable:
        def call(*arguments: Any, **named: Any) -> Any:
            if not self.running:
                return method(*arguments, **named)
            self._inner_s.append(0.0)
            start_s = time.perf_counter()
            try:
                return method(*arguments, **named)
            finally:
                taken_s = time.perf_counter() - start_s
                self.seconds[phase] += taken_s - self._inner_s.pop()
                if self._inner_s:
                    self._inner_s[-1] += taken_s

        return call


class Stepping:
    """The environment without a learner, and the physics inside it alone, on equal inputs."""

    def __init__(self, env: interface.Environment, act: interface.Policy, seed: int) -> None:
        self._env, self._act = env, act
        self._generator = torch.Generator().manual_seed(seed)
        self._observations: Mapping[str, torch.Tensor] = env.reset()
        self._calls: list[tuple[Callable, list[Any], dict[str, Any]]] = []
        self._recording_s = 0.0

    def step(self, steps: int) -> float:
        """Step the environment; return the seconds of its steps."""
        self._calls, self._recording_s, total_s = [], 0.0, 0.0
        with replaced(Rollout, "rollout", self._recorded), torch.no_grad():
            for _ in range(steps):
                action = self._action()
                start_s = time.perf_counter()
                self._observations = self._env.step(action).observations
                total_s += time.perf_counter() - start_s
        return total_s - self._recording_s

    def repeat_physics(self) -> float:
        """Repeat the last steps' calls of the physics; return their seconds."""
        _, _, first = self._calls[0]
        outputs = {name: np.empty_like(first[name]) for name in ("state", "sensordata")}
        start_s = time.perf_counter()
        for rollout, arguments, named in self._calls:
            rollout(*arguments, **(named | outputs))
        return time.perf_counter() - start_s

    def _action(self) -> torch.Tensor:
        shape = (self._env.num_envs, self._env.num_actions)
        noise = ACTION_NOISE * torch.randn(shape, generator=self._generator)
        return self._act(self._observations["actor"]) + noise

    def _recorded(self, rollout: Callable) -> Callable:
        def call(*arguments: Any, **named: Any) -> Any:
            start_s = time.perf_counter()
            kept = [part.copy() if isinstance(part, np.ndarray) else part for part in arguments]
            self._calls.append((rollout, kept, named))
            self._recording_s += time.perf_counter() - start_s
            return rollout(*arguments, **named)

        return call


class Turns:
    """Between two iterations of the loop it steps and repeats the physics; it ends the loop when the time is up.

    The first turn, with the iteration after it, warms up and does not count.
    """

    def __init__(self, stepping: Stepping, watch: Stopwatch, steps: int, seconds: float) -> None:
        self._stepping, self._watch, self._steps, self._seconds = stepping, watch, steps, seconds
        self._start_s = 0.0
        self.counted = -1
        self.stepping_s: list[float] = []
        self.physics_s: list[float] = []

    def is_over(self) -> bool:
        """Asked before every iteration."""
        if self.counted == 0:
            self._start_s = time.perf_counter()
        elif self.counted > 0 and time.perf_counter() - self._start_s >= self._seconds:
            return True
        self._watch.running = False
        stepping_s, physics_s = self._stepping.step(self._steps), self._stepping.repeat_physics()
        if self.counted >= 0:
            self.stepping_s.append(stepping_s)
            self.physics_s.append(physics_s)
            self._watch.running = True
        self.counted += 1
        return False


def measure(setup: Setup, seconds: float) -> dict[str, Any]:
    """Run stepping, physics and loop in turns for about ``seconds``; return the figures."""
    config = setup.config
    torch.set_num_threads(config.threads)
    env, watch = environment_of(setup), Stopwatch()
    learner, still = (build_learner(config, env, setup.robot) for _ in range(2))
    turns = Turns(Stepping(environment_of(setup), still.actor, config.seed), watch, learner.horizon, seconds)
    setup.run_dir.mkdir(exist_ok=True)
    with watch.on_phases(), Path(os.devnull).open("w") as nowhere:
        progress = TrainingProgress(setup.run_dir, console=nowhere)
        budget = Budget(iterations=None, minutes=None)
        hooks = [Reporting(progress, budget), Stopping(budget, turns.is_over)]
        Runner(env, learner, setup.run_dir, {}, hooks).run()
        progress.close()
    per_turn = config.num_envs * learner.horizon
    loop_s = [per_turn / row["time/steps_per_s"] for row in progress.rows[1:]]
    taken_s = {"physics": turns.physics_s, "stepping": turns.stepping_s, "loop": loop_s}
    speeds = {name: per_turn / median(seconds) for name, seconds in taken_s.items()}
    shares = {phase: watch.seconds[phase] / sum(loop_s) for phase in PHASES}
    return {
        **{f"{name}_env_steps_per_s": round(speed, 1) for name, speed in speeds.items()},
        "stepping_over_physics": speeds["stepping"] / speeds["physics"],
        "loop_over_physics": speeds["loop"] / speeds["physics"],
        "loop_shares": shares | {"rest": 1.0 - sum(shares.values())},
        "motion": setup.config.motion_name,
        "num_envs": config.num_envs,
        "horizon": learner.horizon,
        "turns": turns.counted,
        "precision": config.precision,
        "threads": config.threads,
    }


def measure_rounds(setup: Setup, rounds: int) -> dict[str, Any]:
    """Time so many rounds of the learner through a world model, after a short warming up."""
    config, settings = setup.followable, setup.followable.world_model
    assert settings is not None
    torch.set_num_threads(config.torch_threads)
    env, watch = environment_of(setup), Stopwatch(ROUND_PARTS)
    assert isinstance(env, TrackingEnv)
    learner = build_world_model_learner(config, env, setup.robot)
    observations: Mapping[str, torch.Tensor] = env.reset()
    left, begun_s = rounds * settings.round, 0.0
    with watch.on_phases():
        while left:
            for _ in range(learner.horizon):
                result = env.step(learner.act(observations))
                learner.record(result)
                observations = result.observations
            figures = learner.update(observations)
            if watch.running:
                left -= 1
            elif "policy_updates" in figures:  # after a first round
                watch.running, begun_s = True, time.perf_counter()
        taken_s = time.perf_counter() - begun_s
    a_round = {
        "simulated steps": settings.round * settings.collect.steps * config.num_envs,
        "imagined steps": settings.policy.updates * settings.imagination.horizon * settings.imagination.batch,
        "policy updates": settings.policy.updates,
        "model updates": settings.round * (settings.fitting.single_updates + settings.fitting.window_updates),
    }
    shares = {part: watch.seconds[part] / taken_s for part in ROUND_PARTS}
    return {
        "motion": config.motion_name,
        "num_envs": config.num_envs,
        "precision": config.precision,
        "rounds": rounds,
        "per_s": {name: number * rounds / taken_s for name, number in a_round.items()},
        "shares": shares | {"rest": 1.0 - sum(shares.values())},
    }


def print_rounds(figures: dict[str, Any]) -> None:
    """The figures of :func:`measure_rounds` for people."""
    print(", ".join(f"{name} {figures[name]}" for name in ("motion", "num_envs", "precision", "rounds")), end="\n\n")
    for name, rate in figures["per_s"].items():
        print(f"{name:18}{rate:12.4g} per s")
    print(f"\n{'part of a round':18}{'share':>12}")
    for part, share in figures["shares"].items():
        print(f"{part:18}{share:12.1%}")


def print_tables(figures: dict[str, Any]) -> None:
    """The figures for people."""
    told = ("motion", "num_envs", "horizon", "precision", "threads", "turns")
    print(", ".join(f"{name} {figures[name]}" for name in told), end="\n\n")
    print(f"{'':18}{'env steps/s':>12}{'of physics':>12}")
    for name in ("physics", "stepping", "loop"):
        ratio = figures.get(f"{name}_over_physics", 1.0)
        print(f"{name:18}{figures[f'{name}_env_steps_per_s']:12.0f}{ratio:12.2f}")
    print(f"\n{'phase of the loop':18}{'share':>12}")
    for phase, share in figures["loop_shares"].items():
        print(f"{phase:18}{share:12.1%}")


@guarded
def main(arguments: list[str]) -> int:
    """Measure; print tables and, on request, write them as JSON. Returns the exit code."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--motion", default="taichi", metavar="NAME|FILE")
    parser.add_argument("--num-envs", type=int, metavar="N", help="instead of the preset's")
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="after building and warming up")
    parser.add_argument("--world-model", type=int, metavar="ROUNDS", help="so many rounds of the tracker's learner")
    parser.add_argument("--json", type=Path, metavar="F")
    options = parser.parse_args(arguments)
    if not 0.0 < options.seconds < float("inf"):
        raise InputError("not a duration", where="--seconds", got=options.seconds, expected="a number above 0")
    check_output_file("--json", options.json)
    wanted = [f"motion={options.motion}"]
    wanted += [f"num_envs={options.num_envs}"] if options.num_envs is not None else []
    if options.world_model is None:
        wanted += ["train=last_mile"]
    else:
        at_least("--world-model", options.world_model, 1)
        wanted += ["train=tracker", "threads=1", "world_model.processes=1", *BRIEF]
    with tempfile.TemporaryDirectory() as folder:
        setup = new_setup(compose_document([*wanted, f"run_dir={folder}/run"]))
        rounds = options.world_model
        figures = measure(setup, options.seconds) if rounds is None else measure_rounds(setup, rounds)
    (print_tables if rounds is None else print_rounds)(figures)
    if options.json:
        write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
