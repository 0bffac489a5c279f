"""What learning through a world model can be told; the meaning of each key stands in the presets."""

from dataclasses import dataclass, field

from core.errors import InputError
from core.structured import at_least, ordered, positive, within
from train.world_model.cost import COSTS


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
        ordered("world_model.policy.betas", self.policy.betas)
