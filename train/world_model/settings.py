"""What learning through a world model can be told; the meaning of each key stands in the presets."""

import math
from dataclasses import dataclass, field

from core.errors import InputError
from core.structured import at_least, positive, within
from train.world_model.cost import COSTS
from train.world_model.ring import MARGIN

OPEN_LOOP_STEPS = (1, 4, 16, 32)  # after which the model's error is told
WARM_UP_CHUNK = 20  # updates of the model in an iteration before the first round


@dataclass(frozen=True)
class CollectSettings:
    """How simulated robots act: ``steps`` of each between updates, noise by groups of robots, and its memory.

    ``redraw_every``: updates after which the robots' physical constants are drawn anew.
    """

    steps: int
    noise_rad: tuple[float, ...]
    noise_memory: float
    redraw_every: int

    def __post_init__(self) -> None:
        at_least("world_model.collect.steps", self.steps, 1)
        at_least("world_model.collect.redraw_every", self.redraw_every, 1)
        within("world_model.collect.noise_memory", self.noise_memory, 0.0, 0.999)
        if not self.noise_rad:
            raise InputError(
                "no group", where="world_model.collect.noise_rad", expected="one standard deviation or more"
            )
        for std in self.noise_rad:
            at_least("world_model.collect.noise_rad", std, 0.0)


@dataclass(frozen=True)
class FittingSettings:
    """How the world model is fitted: updates on single steps and on windows, each with its batch.

    ``warm_up_*``: before the first policy update.
    """

    hidden: tuple[int, ...]
    learning_rate: float
    weight_decay: float
    last_share: float
    single_updates: int
    single_batch: int
    window_updates: int
    window_batch: int
    window: int
    warm_up_steps: int
    warm_up_single: int
    warm_up_window: int
    warm_up_length: int

    def __post_init__(self) -> None:
        _layers("fitting", self.hidden)
        positive("world_model.fitting.learning_rate", self.learning_rate)
        at_least("world_model.fitting.weight_decay", self.weight_decay, 0.0)
        for name, value in vars(self).items():
            if isinstance(value, int):
                at_least(f"world_model.fitting.{name}", value, 1)
        within("world_model.fitting.last_share", self.last_share, 0.0, 1.0)

    @property
    def longest(self) -> int:
        """Steps of the longest window."""
        return max(self.window, self.warm_up_length)

    @property
    def warm_up_updates(self) -> int:
        """Of the model, before the first round."""
        return self.warm_up_single + self.warm_up_window


@dataclass(frozen=True)
class StartsSettings:
    """Where imagination starts: among the ``newest_steps``; a share in reference frames; near the reference's place."""

    newest_steps: int
    reference_share: float
    place_m: float

    def __post_init__(self) -> None:
        at_least("world_model.starts.newest_steps", self.newest_steps, 1)
        within("world_model.starts.reference_share", self.reference_share, 0.0, 1.0)
        positive("world_model.starts.place_m", self.place_m)


@dataclass(frozen=True)
class LostSettings:
    """An imagined robot is lost beyond these: difference of projected gravities, m of height, m along the ground."""

    tilt: float
    height_m: float
    place_m: float

    def __post_init__(self) -> None:
        for name, bound in vars(self).items():
            positive(f"world_model.imagination.lost.{name}", bound)


@dataclass(frozen=True)
class ImaginationSettings:
    """Steps of a rollout (even), robots in one, and the noise on the actions of every other robot."""

    horizon: int
    batch: int
    noise_rad: float
    noise_memory: float
    lost: LostSettings

    def __post_init__(self) -> None:
        at_least("world_model.imagination.horizon", self.horizon, 2)
        at_least("world_model.imagination.batch", self.batch, 1)
        at_least("world_model.imagination.noise_rad", self.noise_rad, 0.0)
        within("world_model.imagination.noise_memory", self.noise_memory, 0.0, 0.999)
        if self.horizon % 2:
            raise InputError(
                "odd", where="world_model.imagination.horizon", got=self.horizon, expected="an even number of steps"
            )


@dataclass(frozen=True)
class CriticSettings:
    """The value of what comes after a rollout; ``updates``: policy updates before it counts, None: never."""

    hidden: tuple[int, ...]
    learning_rate: float
    batch: int
    lam: float
    average: float
    counts_from: int | None

    def __post_init__(self) -> None:
        _layers("critic", self.hidden)
        positive("world_model.critic.learning_rate", self.learning_rate)
        at_least("world_model.critic.batch", self.batch, 1)
        for name in ("lam", "average"):
            within(f"world_model.critic.{name}", getattr(self, name), 0.0, 1.0)


@dataclass(frozen=True)
class PolicySettings:
    """Network, optimiser, running average and discount of the policy.

    ``updates``: per round; ``last_share``: of the learning rate at the end of the run's policy updates.
    """

    hidden: tuple[int, ...]
    learning_rate: float
    betas: tuple[float, float]
    last_share: float
    average: float
    gamma: float
    updates: int
    cost_max: float
    lost_cost: float

    def __post_init__(self) -> None:
        _layers("policy", self.hidden)
        for name in ("learning_rate", "cost_max"):
            positive(f"world_model.policy.{name}", getattr(self, name))
        at_least("world_model.policy.updates", self.updates, 1)
        for name in ("last_share", "average", "gamma"):
            within(f"world_model.policy.{name}", getattr(self, name), 0.0, 1.0)
        for beta in self.betas:
            within("world_model.policy.betas", beta, 0.0, 0.9999)
        within("world_model.policy.gamma", self.gamma, 0.0, 0.9999)
        at_least("world_model.policy.lost_cost", self.lost_cost, 0.0)


@dataclass(frozen=True)
class WorldModelSettings:
    """``capacity``: steps of all robots that are remembered. ``round``: fitting updates beside ``policy.updates``."""

    capacity: int
    round: int
    processes: int
    collect: CollectSettings
    fitting: FittingSettings
    starts: StartsSettings
    imagination: ImaginationSettings
    critic: CriticSettings
    policy: PolicySettings
    cost: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        at_least("world_model.capacity", self.capacity, 2 * self.starts.newest_steps)
        within("world_model.processes", self.processes, 1, 2)
        at_least("world_model.round", self.round, 1)
        for name, weight in self.cost.items():
            COSTS.check(f"world_model.cost.{name}", name, {})
            at_least(f"world_model.cost.{name}", weight, 0.0)
        if not any(self.cost.values()):
            raise InputError("no cost", where="world_model.cost", expected=COSTS.names)

    def check(self, num_envs: int) -> None:
        """InputError where so many robots do not fill the first windows."""
        needed = num_envs * (max(self.fitting.longest, self.imagination.horizon, *OPEN_LOOP_STEPS) + MARGIN + 2)
        if self.fitting.warm_up_steps < needed:
            raise InputError(
                "too few steps for the windows", where="world_model.fitting.warm_up_steps",
                got=self.fitting.warm_up_steps, expected=f"{needed} or more for {num_envs} robots",
            )  # fmt: skip
        at_least("world_model.starts.newest_steps", self.starts.newest_steps, num_envs)
        if (held := self.capacity // num_envs * num_envs) < self.fitting.warm_up_steps:
            raise InputError(
                "fewer steps than the first update waits for", where="world_model.capacity",
                got=f"{held} steps of {num_envs} robots", expected=f"{self.fitting.warm_up_steps} or more",
            )  # fmt: skip

    def rounds(self, iterations: int, num_envs: int, *, model_known: bool) -> int:
        """Whole rounds of a run. Before them it collects steps and, unless it has another run's, fits the model."""
        return (iterations - self._before_rounds(num_envs, model_known)) // self.round

    def check_rounds(self, iterations: int, num_envs: int, *, model_known: bool) -> None:
        """InputError where a run ends before its first round does: its policy would learn nothing."""
        if self.rounds(iterations, num_envs, model_known=model_known) < 1:
            least = self._before_rounds(num_envs, model_known) + self.round
            raise InputError(
                "the policy would learn nothing", where="iterations", got=iterations,
                expected=f"{least} or more with {num_envs} robots: the world model comes first",
                hint="more robots, or a smaller world_model.fitting.warm_up_steps, need fewer",
            )  # fmt: skip

    def _before_rounds(self, num_envs: int, model_known: bool) -> int:
        """Iterations; the one that collects the last of the first steps fits already, or begins a round."""
        steps, fit = math.ceil(self.fitting.warm_up_steps / num_envs), self.fitting
        updates = 0 if model_known else fit.warm_up_updates
        return math.ceil(steps / self.collect.steps) - 1 + math.ceil(updates / WARM_UP_CHUNK)


def _layers(section: str, hidden: tuple[int, ...]) -> None:
    if not hidden or min(hidden) < 1:
        where = f"world_model.{section}.hidden"
        raise InputError("unusable layers", where=where, got=list(hidden), expected="one or more sizes of at least 1")
