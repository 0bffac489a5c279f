"""What the environment can be told: checked at construction, before any simulation."""

from dataclasses import dataclass, field
from typing import Literal

from core.errors import InputError
from core.structured import at_least, positive, within
from policy.layouts import LAYOUTS
from policy.observation import check_terms
from policy.spec import ObservationGroup, ObservationTerm
from train.mdp.critic_terms import CRITIC_TERMS
from train.mdp.events import EventTerm
from train.mdp.goals import GoalSettings
from train.mdp.rewards import DIRECT, TRACKING
from train.mdp.sensing import SensingSettings
from train.mdp.terminations import TERMINATIONS
from train.simulation.domain import DomainRanges
from train.simulation.model import SimulationSettings

CRITIC = (
    "history", "reference_position", "position_difference", "com_offset", "mass_scale", "kp_scale", "kd_scale",
    "friction", "delay",
)  # fmt: skip


@dataclass(frozen=True)
class RewardTerm:
    """Weight of one reward term; ``sigma`` for tracking terms; ``curriculum``: scaled by the penalty curriculum.

    ``params``: of the term's function.
    """

    weight: float
    sigma: float | None = None
    curriculum: bool = False
    params: dict[str, float] = field(default_factory=dict)

    def check(self, where: str, name: str) -> None:
        """InputError unless ``name`` is a term that these fit."""
        if name not in TRACKING and name not in DIRECT:
            raise InputError("unknown reward term", where=where, expected=sorted([*TRACKING.names, *DIRECT.names]))
        (TRACKING if name in TRACKING else DIRECT).check(f"{where}.params", name, self.params)
        if name in TRACKING and not (self.sigma and self.sigma > 0):
            raise InputError(
                "a tracking term needs a sigma", where=f"{where}.sigma", got=self.sigma, expected="a positive number"
            )


@dataclass(frozen=True)
class CurriculumSettings:
    """A value that moves by ``factor`` per step between bounds while what drives it allows it.

    Where the driver's level is above ``harder_above`` the value moves towards ``hard``; below ``easier_below`` back
    towards ``easy``. ``always``: towards hard whatever happens. ``episode_length``: mean steps of about the last 10,000
    episodes. ``survival``: the chance to survive at the present rates of failures.
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

    def __post_init__(self) -> None:
        for name in ("joint_noise_rad", "tilt_noise_rad", "velocity_noise"):
            at_least(f"environment.start.{name}", getattr(self, name), 0.0)
        within("environment.start.first_frame", self.first_frame, 0.0, 1.0)
        within("environment.start.by_failure", self.by_failure, 0.0, 1.0 - self.first_frame)


@dataclass(frozen=True)
class ClipSettings:
    """How the clip of an episode is drawn where there are several; see :class:`train.mdp.clip_sampler.ClipSampler`.

    ``floor``: share of episodes whose clip is drawn uniformly. ``cap``: by failure a clip gets at most so many times
    the uniform share. ``set_aside``: names of clips that the run does without (:mod:`train.setup`).
    ``in_turn``: robot i tracks clip i instead, and the first follows the last.
    """

    floor: float = 0.2
    cap: float = 5.0
    set_aside: tuple[str, ...] = ()
    in_turn: bool = False

    def __post_init__(self) -> None:
        within("environment.clips.floor", self.floor, 0.0, 1.0)
        positive("environment.clips.cap", self.cap)


@dataclass(frozen=True)
class TerminationSettings:
    """Failure: ``terms`` with their parameters, of which any is enough; None: not this one.

    ``max_episode_s``: an episode that lasts so long is cut, which is no failure; what would come counts by its value.
    ``hold_s``: how long it goes on after the motion's end, in its last pose.
    """

    terms: dict[str, dict[str, float] | None] = field(
        default_factory=lambda: {"tilt": {"limit": 0.75}, "height": {"min_m": 0.0}, "distance": {}}
    )
    max_episode_s: float = 20.0
    hold_s: float = 0.0

    def __post_init__(self) -> None:
        where = "environment.termination"
        for name, params in self.terms.items():
            TERMINATIONS.check(f"{where}.terms.{name}", name, params or {})
        positive(f"{where}.max_episode_s", self.max_episode_s)
        at_least(f"{where}.hold_s", self.hold_s, 0.0)


@dataclass(frozen=True)
class EnvironmentSettings:
    """The environment section of the training configuration.

    ``observations``: what the actor sees: the name of a layout, or terms in order.
    ``critic``: what the critic sees, terms of :mod:`train.mdp.critic_terms` in order.
    ``goals``: what of the reference robots are shown; None: all.
    ``teacher``: the layout of what a teacher sees of the same moments; None: there is none.
    """

    rewards: dict[str, RewardTerm]
    error_limit_m: CurriculumSettings
    penalty_scale: CurriculumSettings
    randomization_scale: CurriculumSettings
    observations: str | tuple[ObservationTerm, ...] = "pbhc"
    critic: tuple[str, ...] = CRITIC
    sigma_alpha: float = 1e-3
    adaptive_sigma: bool = True
    torque_soft_factor: float = 0.85
    penalty_step_max: float | None = None
    start: StartSettings = field(default_factory=StartSettings)
    clips: ClipSettings = field(default_factory=ClipSettings)
    events: dict[str, EventTerm] = field(default_factory=dict)
    termination: TerminationSettings = field(default_factory=TerminationSettings)
    randomization: DomainRanges = field(default_factory=DomainRanges)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    sensing: SensingSettings = field(default_factory=SensingSettings)
    goals: GoalSettings | None = None
    teacher: str | None = None

    def __post_init__(self) -> None:
        for name, term in self.rewards.items():
            term.check(f"environment.rewards.{name}", name)
        if not self.rewards:
            raise InputError("no reward term", where="environment.rewards")
        if not any(name in TRACKING for name in self.rewards):
            raise InputError("no tracking term", where="environment.rewards", expected=TRACKING.names)
        for name, event in self.events.items():
            event.check(f"environment.events.{name}", name)
        for name in ("error_limit_m", "penalty_scale", "randomization_scale"):
            getattr(self, name).check(f"environment.{name}")
        for name in ("easy", "hard"):
            within(f"environment.randomization_scale.{name}", getattr(self.randomization_scale, name), 0.0, 1.0)
        within("environment.sigma_alpha", self.sigma_alpha, 0.0, 1.0)
        positive("environment.torque_soft_factor", self.torque_soft_factor)
        if self.penalty_step_max is not None:
            positive("environment.penalty_step_max", self.penalty_step_max)
        self._check_observations()

    def _check_observations(self) -> None:
        for name in self.critic:
            CRITIC_TERMS.check(f"environment.critic.{name}", name, {})
        if not self.critic:
            raise InputError("no term", where="environment.critic", expected=CRITIC_TERMS.names)
        for name in ("observations", "teacher"):
            layout = getattr(self, name)
            if isinstance(layout, str) and layout not in LAYOUTS:
                where = f"environment.{name}"
                raise InputError("unknown layout", where=where, got=layout, expected=", ".join(LAYOUTS))
        check_terms(self.actor_group(), "environment.observations")

    def actor_group(self) -> ObservationGroup:
        """The layout of the actor's observation."""
        if not isinstance(self.observations, str):
            return ObservationGroup("actor_obs", self.observations)
        return LAYOUTS[self.observations]()

    def teacher_group(self) -> ObservationGroup | None:
        """The layout of the teacher's observation, where there is a teacher."""
        return None if self.teacher is None else LAYOUTS[self.teacher]()

    def groups(self) -> list[ObservationGroup]:
        """The layouts of all who look."""
        return [group for group in (self.actor_group(), self.teacher_group()) if group is not None]
