"""The motion tracking environment (PBHC): one clip per environment, one step per control period."""

import itertools
from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Any

import torch

from core.rotations import projected_gravity, quat_rotate
from robot.robot import Robot
from train.interface import StepResult
from train.mdp.adaptive_sigma import AdaptiveSigma
from train.mdp.anchor import Anchor
from train.mdp.curriculum import AVERAGED_EPISODES, Curriculum, EpisodeAverage
from train.mdp.divergence import without_diverged
from train.mdp.failures import FailureRates
from train.mdp.observations import Observations, domain_view, reference_view
from train.mdp.pushes import Pushes
from train.mdp.rewards import DIRECT, TRACKING
from train.mdp.settings import EnvironmentSettings
from train.mdp.starts import StartSampler
from train.mdp.tick import Bodies, ReferenceRows, ReferenceTable, RobotLimits, Tick
from train.mdp.tracking_log import TrackingLog, tracking_errors
from train.phase_basis import num_knots, phase_hats
from train.simulation.simulator import PhysicsState, Simulator

CONTROL_PERIOD_S = 0.02
ACTION_SCALE = 0.25
ACTION_CLIP = 100.0
OBSERVATION_CLIP = 100.0
CONTACT_FORCE_N = 1.0
RANDOMIZATION_STEP = 0.02


class TrackingEnv:
    """B robots that track reference motions.

    Args:
        robot: the robot.
        table: the references.
        simulator: the physics.
        settings: terms, weights, curricula.
        generator: source of what each step draws, outside physics.
        episodes: source of what each episode draws, outside physics. Another one, so that episodes which end here or
            there leave the steps' draws as they are (:class:`train.mdp.paired.PairedEnv`).
        recovery: motions of ``settings.start.recovery``, where there are any.
    """

    def __init__(
        self,
        robot: Robot,
        table: ReferenceTable,
        simulator: Simulator,
        settings: EnvironmentSettings,
        generator: torch.Generator,
        episodes: torch.Generator,
        recovery: ReferenceTable | None = None,
    ) -> None:
        self.num_envs, self.num_actions = simulator.num_envs, robot.num_joints
        self.reward_names = tuple(settings.rewards)
        self.settings, self.simulator, self._table, self._generator = settings, simulator, table, generator
        self.num_ticks = table.num_ticks
        self._episodes = episodes
        self._generators = [generator, episodes, simulator.generator, simulator.episodes]
        self._kinematics = robot.kinematics
        self.most_steps = round(settings.termination.max_episode_s / CONTROL_PERIOD_S)
        self.last_tick = table.num_ticks + round(settings.termination.hold_s / CONTROL_PERIOD_S)
        self.limits = RobotLimits.of(robot, torque_factor=settings.torque_soft_factor)
        self._phase_knots = (
            num_knots(int(table.num_ticks.max()) * CONTROL_PERIOD_S) if settings.critic_phase_knots else 0
        )
        self._torque_limit = torch.tensor(robot.torque_limit_nm).float()
        self.failures = FailureRates(table.num_ticks)
        self.starts = StartSampler(settings.start, table.num_ticks, episodes, recovery)
        self._allocate(robot)
        self._physics = simulator.state()
        self._bodies = self._forward(self._physics)
        self.position_error_m, self.error_change_m = (torch.zeros_like(self._bodies.pos_w) for _ in range(2))
        self._target = self._next_target()
        actor = {"terms": self.reset()["actor"]}
        self.layout = {"actor": _columns(actor), "critic": _columns(self._critic_terms(torch.arange(1)))}
        self.device = self.tick.device

    def _allocate(self, robot: Robot) -> None:
        s, envs = self.settings, self.num_envs
        self.observations = Observations(robot, envs, s.observation_noise, s.older_ticks())
        self.pushes = Pushes(s.push, envs, CONTROL_PERIOD_S, self._generator)
        self.anchor = Anchor(envs, s.anchor_time_s, CONTROL_PERIOD_S)
        tracking = [name for name in self.reward_names if name in TRACKING]
        self.sigma = AdaptiveSigma(
            {name: float(s.rewards[name].sigma or 0.0) for name in tracking}, s.sigma_alpha, adaptive=s.adaptive_sigma
        )
        self.error_limit = Curriculum(s.error_limit_m)
        self.penalty_scale = Curriculum(s.penalty_scale)
        self.randomization = Curriculum(s.randomization_scale)
        self.average, self.uniform_average = EpisodeAverage(), EpisodeAverage()
        self._log = TrackingLog()
        self._tracking_index = torch.tensor([self.reward_names.index(name) for name in tracking])
        self._direct = [(i, name) for i, name in enumerate(self.reward_names) if name in DIRECT]
        self._weight = torch.tensor([s.rewards[name].weight for name in self.reward_names]) * CONTROL_PERIOD_S
        self._in_curriculum = torch.tensor([s.rewards[name].curriculum for name in self.reward_names])
        self.clip = torch.arange(envs) % len(self._table.num_ticks)
        self.tick, self.start_tick, self.episode_steps = (torch.zeros(envs, dtype=torch.long) for _ in range(3))
        self.uniform_start, self.diverged = (torch.zeros(envs, dtype=torch.bool) for _ in range(2))
        self.last_action = torch.zeros(envs, self.num_actions)
        self.air_time_s = torch.zeros(envs, 2)

    def reset(self) -> dict[str, torch.Tensor]:
        """Begin a new episode in every environment; return its observations."""
        self._reset(torch.arange(self.num_envs))
        return self._observe()

    def step(self, action: torch.Tensor) -> StepResult:
        """Advance by one control period with raw actions (B, J). NonFiniteError if the physics of many diverges."""
        self.pushes.apply(self.simulator, self.simulator.randomization)
        targets = self.limits.default_pos_rad + ACTION_SCALE * action.clamp(-ACTION_CLIP, ACTION_CLIP)
        self.simulator.step(targets)
        self.tick += 1
        self.episode_steps += 1
        t = self._after_physics(action, targets)
        rewards = self._rewards(t)
        timed_out = self._timed_out(t)
        ended = t.terminated | timed_out
        self.last_errors = tracking_errors(t)
        self._keep(t)
        self._update_curricula(t, ended)
        log = self._log.step(self)
        final_critic_obs = self._critic(timed_out.nonzero()[:, 0])
        self._reset(ended.nonzero()[:, 0])
        return StepResult(self._observe(), rewards, t.terminated, timed_out, final_critic_obs, log)

    def _after_physics(self, action: torch.Tensor, targets: torch.Tensor) -> Tick:
        physics, self.diverged = without_diverged(self.simulator.state(), self._physics)
        bodies = self._forward(physics)
        reference = self._target
        torque = self.limits.kp * (targets - physics.joint_pos_rad) - self.limits.kd * physics.joint_vel_rad_s
        contact = physics.foot_force_w.norm(dim=-1) > CONTACT_FORCE_N
        air_time_s = self.air_time_s + CONTROL_PERIOD_S
        return Tick(
            physics=physics,
            bodies=bodies,
            reference=reference,
            action=action,
            last_action=self.last_action,
            torque_nm=torch.clamp(torque, -self._torque_limit, self._torque_limit),
            contact=contact,
            first_contact=contact & (self.air_time_s > 0.0),
            air_time_s=air_time_s,
            acceleration_error_m=bodies.pos_w - reference.body_pos_w - self.position_error_m - self.error_change_m,
            terminated=self._failed(physics, bodies, reference) | self.diverged,
            limits=self.limits,
        )

    def _forward(self, physics: PhysicsState) -> Bodies:
        """By numpy, whose operations on a few hundred robots start in half of torch's time."""
        ang_vel_w = quat_rotate(physics.root_quat_wxyz, physics.root_ang_vel_b)
        state = self._kinematics.forward(
            physics.root_pos_w.numpy(),
            physics.root_quat_wxyz.numpy(),
            physics.joint_pos_rad.numpy(),
            physics.root_lin_vel_w.numpy(),
            ang_vel_w.numpy(),
            physics.joint_vel_rad_s.numpy(),
        )
        return Bodies(*map(torch.from_numpy, state))

    def _failed(self, physics: PhysicsState, bodies: Bodies, reference: ReferenceRows) -> torch.Tensor:
        rule = self.settings.termination
        failed = projected_gravity(physics.root_quat_wxyz)[:, :2].norm(dim=1) > rule.tilt
        failed |= physics.root_pos_w[:, 2] < rule.min_height_m
        if rule.distance:
            distance = (bodies.pos_w - reference.body_pos_w).norm(dim=-1).amax(dim=1)
            failed |= distance > self.error_limit.value
        return failed

    def _rewards(self, t: Tick) -> torch.Tensor:
        values = torch.empty(self.num_envs, len(self.reward_names))
        errors = torch.stack([TRACKING[name](t) for name in self.sigma.names], dim=1)
        values[:, self._tracking_index] = self.sigma.reward(errors)
        self.sigma.update(errors)
        for column, name in self._direct:
            values[:, column] = DIRECT[name](t)
        rewards = values * torch.where(self._in_curriculum, self._weight * self.penalty_scale.value, self._weight)
        if self.settings.penalty_step_max is None:
            return rewards
        return torch.where(self._in_curriculum, rewards.clamp(min=-self.settings.penalty_step_max), rewards)

    def _timed_out(self, t: Tick) -> torch.Tensor:
        over = (self.tick >= self.last_tick[self.clip]) | (self.episode_steps >= self.most_steps)
        return over & ~t.terminated

    def _keep(self, t: Tick) -> None:
        """Hand what the next step starts from over to it."""
        self.last_action = t.action.clone()
        self.air_time_s = torch.where(t.contact, 0.0, t.air_time_s)
        position_error_m = t.bodies.pos_w - t.reference.body_pos_w
        self.error_change_m = position_error_m - self.position_error_m
        self.position_error_m = position_error_m
        self._physics, self._bodies = t.physics, t.bodies
        self.anchor.follow(t.physics.root_pos_w, t.physics.root_quat_wxyz, t.reference)
        self._target = self._next_target()
        self.observations.push(*self._sample(t.physics, t.action, t.reference.phase, self._generator))

    def _next_target(self) -> ReferenceRows:
        return self.anchor.moved(self._table.rows(self.clip, self.tick + 1))

    def _update_curricula(self, t: Tick, ended: torch.Tensor) -> None:
        self._log.episodes(self, ended)
        survived = ~t.terminated
        self.average.update(self.episode_steps[ended], survived[ended], window=AVERAGED_EPISODES)
        uniform = ended & self.uniform_start
        self.uniform_average.update(self.episode_steps[uniform], survived[uniform], window=self.num_envs)
        self.failures.update(self.clip, self.tick, t.terminated)
        self.survival_chance = self.failures.survival()
        for curriculum in (self.error_limit, self.penalty_scale, self.randomization):
            curriculum.update(length=self.average.length, survival=self.survival_chance)

    def _reset(self, env_ids: torch.Tensor) -> None:
        if len(env_ids) == 0:
            return
        clip = self.clip[env_ids]
        tick, uniform = self.starts.draw(clip, self.failures.ahead())
        rows = self._table.rows(clip, tick)
        self.simulator.reset(env_ids, *self.starts.state(rows, tick == 0))
        self.tick[env_ids], self.start_tick[env_ids], self.uniform_start[env_ids] = tick, tick, uniform
        self.episode_steps[env_ids] = 0
        self.last_action[env_ids] = 0.0
        self.air_time_s[env_ids] = 0.0
        self.anchor.restart(env_ids)
        self._physics = self.simulator.state()
        fresh = PhysicsState(*(value[env_ids] for value in vars(self._physics).values()))
        bodies = self._forward(fresh)
        _write_rows(self._bodies, env_ids, bodies)
        self.position_error_m[env_ids] = bodies.pos_w - rows.body_pos_w
        self.error_change_m[env_ids] = CONTROL_PERIOD_S * (bodies.lin_vel_w - rows.body_lin_vel_w)
        _write_rows(vars(self._target).values(), env_ids, vars(self._table.rows(clip, tick + 1)).values())
        self.observations.restart(env_ids, *self._sample(fresh, self.last_action[env_ids], rows.phase, self._episodes))

    def _sample(
        self, physics: PhysicsState, last_action: torch.Tensor, phase: torch.Tensor, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Sensor noise grows with the randomisation."""
        scale = self.simulator.randomization
        return self.observations.sample(physics, last_action, phase, noise_scale=scale, generator=generator)

    def _observe(self) -> dict[str, torch.Tensor]:
        return {"actor": self.observations.actor(), "critic": self._critic(torch.arange(self.num_envs))}

    def _critic(self, rows: torch.Tensor) -> torch.Tensor:
        return torch.cat([*self._critic_terms(rows).values()], dim=1).clamp(-OBSERVATION_CLIP, OBSERVATION_CLIP)

    def _critic_terms(self, rows: torch.Tensor) -> dict[str, torch.Tensor]:
        physics = PhysicsState(*(value[rows] for value in vars(self._physics).values()))
        bodies = Bodies(*(value[rows] for value in self._bodies))
        terms = {
            "history": self.observations.critic_history[rows].flatten(1),
            "reference": reference_view(physics, bodies, self._target.body_pos_w[rows]),
            "domain": domain_view(self.simulator.domain, self.simulator.delay_s)[rows],
        }
        if self._phase_knots:
            phase = (self.tick[rows] / self.num_ticks[self.clip[rows]]).clamp(max=1.0)
            terms["phase_knots"] = phase_hats(phase, self._phase_knots)
        return terms

    def finish_iteration(self) -> None:
        """Apply what changes between iterations only, as it touches every model: the width of the randomisation."""
        wanted, hard = self.randomization.value, self.settings.randomization_scale.hard
        step = abs(wanted - self.simulator.randomization)
        if step >= RANDOMIZATION_STEP or (step > 0.0 and wanted == hard):
            self.simulator.set_randomization(wanted)
            self.sigma.restart()

    def follow(self, leader: "TrackingEnv", rows: torch.Tensor) -> None:
        """Take the robots of ``rows`` (B,) bool to where ``leader``'s are, and all that is nobody's own with them."""
        for own, its in zip(self._robots(), leader._robots(), strict=True):
            own[rows] = its[rows]
        self._physics = self.simulator.state()
        self._load_common(leader._common())

    def _robots(self) -> list[torch.Tensor]:
        """Tensors (B, ...) that hold a row for each robot; the present ones, no copies."""
        return [*self.simulator.robots(), *map(self._buffer, _BUFFERS), *self._bodies, *vars(self._target).values()]

    def _common(self) -> dict[str, Any]:
        """What is nobody's own, as tensors and plain numbers."""
        return {
            "sigma": self.sigma.state_dict(),
            "failures": self.failures.state_dict(),
            "curricula": {name: getattr(self, name).value for name in _CURRICULA},
            "averages": {name: dict(vars(getattr(self, name))) for name in _AVERAGES},
            "generators": [generator.get_state() for generator in self._generators],
        }

    def _load_common(self, state: dict[str, Any]) -> None:
        self.sigma.load_state_dict(state["sigma"])
        self.failures.load_state_dict(state["failures"])
        for name in _CURRICULA:
            getattr(self, name).value = state["curricula"][name]
        for name, values in state["averages"].items():
            vars(getattr(self, name)).update(values)
        for generator, value in zip(self._generators, state["generators"], strict=True):
            generator.set_state(value)

    def state_dict(self) -> dict[str, Any]:
        """Everything that a continued run needs, as tensors and plain numbers."""
        return self._common() | {
            "simulator": self.simulator.state_dict(),
            "buffers": {name: self._buffer(name).clone() for name in _BUFFERS},
            "bodies": [value.clone() for value in self._bodies],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.simulator.load_state_dict(state["simulator"])
        for name in _BUFFERS:
            self._buffer(name).copy_(state["buffers"][name])
        self._physics = self.simulator.state()
        self._bodies = Bodies(*(value.clone() for value in state["bodies"]))
        self._target = self._next_target()
        self._load_common(state)

    def _buffer(self, path: str) -> torch.Tensor:
        return attrgetter(path)(self)


_AVERAGES = ("average", "uniform_average", "_log")
_CURRICULA = ("error_limit", "penalty_scale", "randomization")
_BUFFERS = (
    "clip", "tick", "start_tick", "episode_steps", "uniform_start", "last_action", "air_time_s",
    "position_error_m", "error_change_m",
    "observations.actor_history", "observations.critic_history", "pushes.wait_s",
    "anchor.place_m", "anchor.heading_rad",
)  # fmt: skip


def _columns(terms: Mapping[str, torch.Tensor]) -> dict[str, slice]:
    ends = [0, *itertools.accumulate(term.shape[1] for term in terms.values())]
    return {name: slice(*part) for name, part in zip(terms, itertools.pairwise(ends), strict=True)}


def _write_rows(tables: Iterable[torch.Tensor], rows: torch.Tensor, values: Iterable[torch.Tensor]) -> None:
    for table, value in zip(tables, values):
        table[rows] = value
