"""What the environment can be told: checked at construction, before any simulation."""

import itertools
from dataclasses import dataclass, field
from typing import Literal

from core.errors import InputError
from core.structured import at_least, ordered, positive, within
from policy.spec import MAX_LAG
from policy.terms import TERMS as OBSERVATION_TERMS
from train.mdp.rewards import DIRECT, TRACKING
from train.simulation.domain import DomainRanges


@dataclass(frozen=True)
class RewardTerm:
    """Weight of one reward term; ``sigma`` for tracking terms; ``curriculum``: scaled by the penalty curriculum."""

    weight: float
    sigma: float | None = None
    curriculum: bool = False


@dataclass(frozen=True)
class CurriculumSettings:
    """A value that moves by ``factor`` per step between bounds while the driver allows it.

    ``driver``: ``always`` (one way), ``episode_length`` (mean length in steps of the last 10,000 episodes) or
    ``survival`` (chance to survive the whole clip at the present rates of failures). Above ``harder_above`` the value
    moves towards ``hard``; below ``easier_below`` back towards ``easy``.
    """

    start: float
    easy: float
    hard: float
    factor: float
    driver: Literal["always", "episode_length", "survival"] = "always"
    harder_above: float = 0.0
    easier_below: float = 0.0

    def check(self, where: str) -> None:
        """InputError unless this is a way from easy to hard."""
        for name in ("start", "easy", "hard", "factor"):
            at_least(f"{where}.{name}", getattr(self, name), 0.0)
        within(f"{where}.start", self.start, *sorted((self.easy, self.hard)))
        if self.hard > 0.0 and self.factor > 0.0:  # nothing grows from zero by a factor
            positive(f"{where}.start", self.start)


@dataclass(frozen=True)
class RecoverySettings:
    """Starts from which the robot must find back: any frame of other ``motions``, moved to where the reference stands.

    ``share`` of all starts are such. ``velocity_m_s``: drawn from ± this in x and y and added to the whole robot's.
    """

    share: float = 0.0
    motions: tuple[str, ...] = ()
    velocity_m_s: float = 0.0

    def __post_init__(self) -> None:
        where = "environment.start.recovery"
        within(f"{where}.share", self.share, 0.0, 1.0)
        at_least(f"{where}.velocity_m_s", self.velocity_m_s, 0.0)
        if self.share > 0.0 and not self.motions:
            raise InputError("no motion", where=f"{where}.motions", expected="clips or files where share is above 0")


@dataclass(frozen=True)
class StartSettings:
    """Where episodes begin: shares of the first frame and of phases before failures; the rest is uniform.

    Noise is the standard deviation of normals added to a start state; ``first_frame_at_rest`` zeroes velocities there.
    """

    first_frame: float = 0.0
    by_failure: float = 0.0
    joint_noise_rad: float = 0.0
    tilt_noise_rad: float = 0.0
    velocity_noise: float = 0.0
    first_frame_at_rest: bool = True
    recovery: RecoverySettings = field(default_factory=RecoverySettings)

    def __post_init__(self) -> None:
        for name in ("joint_noise_rad", "tilt_noise_rad", "velocity_noise"):
            at_least(f"environment.start.{name}", getattr(self, name), 0.0)
        within("environment.start.first_frame", self.first_frame, 0.0, 1.0)
        within("environment.start.by_failure", self.by_failure, 0.0, 1.0 - self.first_frame)


@dataclass(frozen=True)
class PushSettings:
    """Horizontal pushes: a velocity drawn from ±velocity_m_s in x and y, every interval drawn from interval_s."""

    velocity_m_s: float = 0.0
    interval_s: tuple[float, float] = (5.0, 10.0)

    def __post_init__(self) -> None:
        at_least("environment.push.velocity_m_s", self.velocity_m_s, 0.0)
        ordered("environment.push.interval_s", self.interval_s)
        positive("environment.push.interval_s[0]", self.interval_s[0])


@dataclass(frozen=True)
class TerminationSettings:
    """Failure: tilt (norm of the horizontal projected gravity), distance of any point, pelvis height.

    ``max_episode_s``: an episode that lasts so long is cut, which is no failure; what would come counts by its value.
    ``hold_s``: how long it goes on after the motion's end, in its last pose.
    """

    tilt: float = 0.75
    distance: bool = True
    min_height_m: float = 0.0
    max_episode_s: float = 20.0
    hold_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("tilt", "max_episode_s"):
            positive(f"environment.termination.{name}", getattr(self, name))
        at_least("environment.termination.hold_s", self.hold_s, 0.0)


@dataclass(frozen=True)
class SimulationSettings:
    """Physics steps per control step, and whether joints keep their friction loss."""

    substeps: int = 4
    joint_friction: bool = True


@dataclass(frozen=True)
class EnvironmentSettings:
    """The environment section of the training configuration.

    ``critic_phase_knots``: whether the critic sees the phase as :func:`train.phase_basis.phase_hats` too, and through
    :class:`train.learner.normalizer.PhaseNormalizer` how far it is off what is usual there.
    ``older_lags``: blocks of earlier ticks that the actor sees too; the network sees the mean deviation in each.
    ``anchor_time_s``: see :class:`train.mdp.anchor.Anchor`.
    """

    rewards: dict[str, RewardTerm]
    observation_noise: dict[str, float]
    error_limit_m: CurriculumSettings
    penalty_scale: CurriculumSettings
    randomization_scale: CurriculumSettings
    sigma_alpha: float = 1e-3
    adaptive_sigma: bool = True
    torque_soft_factor: float = 0.85
    critic_phase_knots: bool = False
    older_lags: tuple[tuple[int, ...], ...] = ()
    penalty_step_max: float | None = None
    anchor_time_s: float | None = None
    start: StartSettings = field(default_factory=StartSettings)
    push: PushSettings = field(default_factory=PushSettings)
    termination: TerminationSettings = field(default_factory=TerminationSettings)
    randomization: DomainRanges = field(default_factory=DomainRanges)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)

    def __post_init__(self) -> None:
        known = TRACKING.keys() | DIRECT.keys()
        for name, term in self.rewards.items():
            if name not in known:
                raise InputError("unknown reward term", where=f"environment.rewards.{name}", expected=sorted(known))
            if name in TRACKING and not (term.sigma and term.sigma > 0):
                raise InputError(
                    "a tracking term needs a sigma", where=f"environment.rewards.{name}.sigma", got=term.sigma,
                    expected="a positive number",
                )  # fmt: skip
        if not self.rewards:
            raise InputError("no reward term", where="environment.rewards")
        if not self.rewards.keys() & TRACKING.keys():
            raise InputError("no tracking term", where="environment.rewards", expected=sorted(TRACKING))
        at_least("environment.simulation.substeps", self.simulation.substeps, 1)
        for name, noise in self.observation_noise.items():
            if name not in OBSERVATION_TERMS:
                raise InputError(
                    "unknown observation term", where=f"environment.observation_noise.{name}",
                    expected=sorted(OBSERVATION_TERMS),
                )  # fmt: skip
            at_least(f"environment.observation_noise.{name}", noise, 0.0)
        for name in ("error_limit_m", "penalty_scale", "randomization_scale"):
            getattr(self, name).check(f"environment.{name}")
        for name in ("easy", "hard"):
            within(f"environment.randomization_scale.{name}", getattr(self.randomization_scale, name), 0.0, 1.0)
        within("environment.sigma_alpha", self.sigma_alpha, 0.0, 1.0)
        positive("environment.torque_soft_factor", self.torque_soft_factor)
        lags = self.older_ticks()
        rising = all(a < b for a, b in itertools.pairwise((4, *lags, MAX_LAG + 1)))
        if not rising or not all(self.older_lags):
            raise InputError(
                "unusable lags", where="environment.older_lags", got=[list(block) for block in self.older_lags],
                expected=f"blocks of ticks from 5 to {MAX_LAG}, rising from one to the next",
            )  # fmt: skip
        if self.penalty_step_max is not None:
            positive("environment.penalty_step_max", self.penalty_step_max)
        if self.anchor_time_s is not None:
            positive("environment.anchor_time_s", self.anchor_time_s)

    def older_ticks(self) -> tuple[int, ...]:
        """All of ``older_lags``, in order."""
        return tuple(itertools.chain.from_iterable(self.older_lags))
