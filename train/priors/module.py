"""The action prior as a network layer: it is exported into the same graph as the actor's network, the residual."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import torch
from torch import nn

from core.errors import InputError
from core.structured import at_least, positive
from motion.feet import ground_lift_m
from motion.reference import Reference
from policy.spec import ObservationGroup
from robot.robot import Robot
from train.phase_basis import num_knots
from train.priors.estimator import PBHC, Deviation, Drift, ObservedColumns, interpolate, reference_observation
from train.priors.feasible import Nominal, feasible_motion
from train.priors.features import NominalFeatures
from train.priors.feedback import FeedbackCosts, add_stance_welds, feedback_gains
from train.priors.feedforward import feedforward_targets
from train.priors.plant import SUBSTEP_S
from world.model import compile_model


@dataclass(frozen=True)
class PriorSettings:
    """``kind``: ``lqr`` (feed-forward and feedback), ``feedforward``, ``observed`` (the feed-forward targets that the
    actor sees, with a bounded residual; of any clip) or ``none``.

    ``aim``: what the feedback holds the robot to, the ``reference`` or the nearest ``feasible`` motion.
    ``estimate``: how the deviation is estimated, by averages alone or with a correction fitted to rollouts.
    ``features``: whether the actor's network sees :class:`train.priors.features.NominalFeatures` too.
    ``fit_noise_std``: noise on the raw actions while rollouts are gathered for the fit.
    ``feedback_clip_rad`` bounds the feedback per joint; ``knot_ticks`` is the spacing of the stored gains.
    Cheap targets (``costs``) track best without sensor noise and shake with it.
    """

    kind: Literal["lqr", "feedforward", "observed", "none"] = "lqr"
    aim: Literal["feasible", "reference"] = "reference"
    estimate: Literal["averaged", "fitted"] = "averaged"
    features: bool = False
    fit_noise_std: float = 0.15
    feedback_clip_rad: float = 0.6
    knot_ticks: int = 10
    costs: FeedbackCosts = field(default_factory=FeedbackCosts)

    def __post_init__(self) -> None:
        positive("prior.feedback_clip_rad", self.feedback_clip_rad)
        at_least("prior.knot_ticks", self.knot_ticks, 1)
        at_least("prior.fit_noise_std", self.fit_noise_std, 0.0)

    def check(self, older_lags: tuple[tuple[int, ...], ...]) -> None:
        """InputError where nothing would look at ``older_lags`` of the observation."""
        if older_lags and not self.features:
            raise InputError(
                "nothing looks at them", where="environment.older_lags", got=older_lags,
                expected="prior.features=true with them, or none",
            )  # fmt: skip


class ModelPrior(nn.Module):
    """Raw action (B, J) of the model-based controller for actor observations (B, 380).

    target = feed-forward target(phase) − clip(gains(phase)·deviation), where the deviation from the reference is
    estimated from the history by :class:`train.priors.estimator.Deviation`.
    """

    targets: torch.Tensor
    gains: torch.Tensor

    def __init__(
        self,
        deviation: Deviation,
        phase_column: int,
        targets: np.ndarray,
        gains: np.ndarray,
        feedback_clip: float,
        stretch: float,
        features: NominalFeatures | None = None,
    ) -> None:
        super().__init__()
        self.deviation, self.features = deviation, features
        self.inputs, self.unseen = (0, 0) if features is None else (features.size, features.unseen)
        self._joints, self._width = gains.shape[1:]
        self._phase_column, self._clip, self._stretch = phase_column, feedback_clip, stretch
        self.register_buffer("targets", torch.tensor(targets).float())
        self.register_buffer("gains", torch.tensor(gains.reshape(len(gains), -1)).float())

    def phase(self, observation: torch.Tensor) -> torch.Tensor:
        """Where in its tables (B,), 0 to 1, an observation (B, 380+) is."""
        return (observation[:, self._phase_column] * self._stretch).clamp(0.0, 1.0)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """See the class."""
        return self.look(observation)[0]

    def look(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor | None]:
        """The action, and the features (B, F) that the network sees of what it was computed from."""
        phase = self.phase(observation)
        deviation, drift = self.deviation(observation, phase)
        features = None if self.features is None else self.features(phase, deviation, drift)
        return interpolate(self.targets, phase) - self._feedback(phase, deviation), features

    def _feedback(self, phase: torch.Tensor, deviation: torch.Tensor) -> torch.Tensor:
        gain = interpolate(self.gains, phase).reshape(-1, self._joints, self._width)
        # In double: far off the reference the products are large and cancel.
        feedback = torch.matmul(gain.double(), deviation.double().unsqueeze(-1)).squeeze(-1).float()
        return feedback.clamp(-self._clip, self._clip)


def build_prior(
    settings: PriorSettings,
    robot: Robot,
    reference: Reference,
    action_scale: float,
    *,
    group: ObservationGroup = PBHC,
    older_lags: tuple[tuple[int, ...], ...] = (),
    threads: int = 1,
    stored: Path | None = None,
    progress: Callable[[str], None] = lambda line: None,
) -> ModelPrior | None:
    """Compute the prior of a reference for actors that see ``group``; ``None`` where the settings say so.

    Takes some seconds; with a feasible aim some minutes, unless it is ``stored`` there from an earlier call.
    """
    s = settings
    if s.kind == "none":
        return None
    model = linearization_model(robot)
    nominal = Nominal(reference, feedforward_targets(model, robot, reference))
    if s.aim == "feasible":
        nominal = _feasible(robot, nominal, threads, stored, progress)
    joints = robot.num_joints
    gains = _gains(s, model, robot, nominal, reference)
    raw = (nominal.targets_rad - robot.default_pos_rad) / action_scale
    layout = ObservedColumns.of(robot, group)
    last_raw = np.vstack([raw[:1], raw[:-1]])
    observed = torch.tensor(reference_observation(robot, nominal.reference, last_raw)).float()
    drift = Drift(older_lags, joints, observed) if older_lags else None
    deviation = Deviation(layout, observed, drift)
    # Deviations are in physical units, of the previous action in raw ones; feedback is in raw actions.
    gains[..., -joints:] *= action_scale
    # A clip may end between two ticks, the tables end with the last tick.
    stretch = reference.duration_s / (reference.num_ticks * reference.dt_s)
    features = NominalFeatures(deviation, num_knots(reference.duration_s)) if s.features else None
    return ModelPrior(
        deviation, layout.phase, raw, gains / action_scale, s.feedback_clip_rad / action_scale, stretch, features
    )


def _gains(s: PriorSettings, model: mujoco.MjModel, robot: Robot, nominal: Nominal, reference: Reference) -> np.ndarray:
    """(knots, J, 6+3J) of the feedback at even phases; zero without one."""
    if s.kind != "lqr":
        return np.zeros((2, robot.num_joints, 6 + 3 * robot.num_joints))
    gains = feedback_gains(model, robot, nominal.reference, nominal.targets_rad, s.costs, s.knot_ticks)
    return _at_even_phases(gains, reference, s.knot_ticks)


def _feasible(
    robot: Robot, wanted: Nominal, threads: int, stored: Path | None, progress: Callable[[str], None]
) -> Nominal:
    if stored is not None and stored.is_file():
        return Nominal.load(stored, wanted.reference)
    found = feasible_motion(robot, wanted, ground_lift_m(robot, wanted.reference), threads=threads, progress=progress)
    if stored is not None:
        found.save(stored)
    return found


def linearization_model(robot: Robot) -> mujoco.MjModel:
    """The robot with weldable feet and without what a linearisation cannot see: contacts, friction, limits."""
    model = compile_model(
        robot,
        timestep_s=SUBSTEP_S,
        actuation="pd_position",
        strip_visuals=True,
        edit=lambda spec: add_stance_welds(spec, robot),
    )
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS
    model.actuator_forcelimited[:] = 0
    return model


def _at_even_phases(gains: np.ndarray, reference: Reference, stride: int) -> np.ndarray:
    """Resample gains from every ``stride``-th tick to knots spread evenly over phases 0 to 1."""
    at = np.linspace(0.0, reference.num_ticks / stride, reference.num_ticks // stride + 1)
    low = np.minimum(at.astype(int), len(gains) - 2) if len(gains) > 1 else np.zeros(len(at), dtype=int)
    high = np.minimum(low + 1, len(gains) - 1)
    weight = np.minimum(at - low, 1.0)[:, None, None]
    return gains[low] * (1.0 - weight) + gains[high] * weight
