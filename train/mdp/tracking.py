"""The motion tracking environment (PBHC): many robots, one step per control period."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch

from policy.action import decode_action
from policy.spec import ObservationGroup
from robot.robot import Robot
from train.batch import Device
from train.interface import StepResult
from train.mdp.command import Command
from train.mdp.critic import Critic
from train.mdp.curriculum import AVERAGED_EPISODES, Curriculum, EpisodeAverage
from train.mdp.divergence import without_diverged
from train.mdp.events import Events
from train.mdp.goals import errors_by_kind
from train.mdp.observations import Observations
from train.mdp.physics import Physics
from train.mdp.reward_sum import RewardSum
from train.mdp.sensing import Sensing, Sensors, senses_of
from train.mdp.settings import EnvironmentSettings
from train.mdp.state import EnvState
from train.mdp.terminations import TERMINATIONS
from train.mdp.tick import RobotLimits, StepOutcome
from train.mdp.tracking_log import LengthRatio, tracking_errors
from train.simulation.simulator import Simulator

CONTROL_PERIOD_S = 0.02
ACTION_SCALE = 0.25
ACTION_CLIP = 100.0
CONTACT_FORCE_N = 1.0
RANDOMIZATION_STEP = 0.02


class TrackingEnv:
    """B robots that track reference motions.

    Args:
        robot: the robot.
        command: what they track.
        simulator: the physics.
        settings: terms, weights, curricula.
        generator: source of what each step draws, outside physics.
        episodes: source of what each episode draws, outside physics. Another one, so that episodes which end here or
            there leave the steps' draws as they are (:class:`train.mdp.paired.PairedEnv`).
        device: where the tensors are; the simulator keeps its own.
    """

    def __init__(
        self,
        robot: Robot,
        command: Command,
        simulator: Simulator,
        settings: EnvironmentSettings,
        generator: torch.Generator,
        episodes: torch.Generator,
        device: Device,
    ) -> None:
        s = settings
        self.num_envs, self.num_actions, self.device = simulator.num_envs, robot.num_joints, torch.device(device)
        self.settings, self.simulator, self.command = settings, simulator, command
        self._generator, self._episodes = generator, episodes
        self._generators = [generator, episodes, simulator.generator, simulator.episodes]
        self._physics = Physics(simulator, robot, device)
        self.limits = RobotLimits.of(robot, torque_factor=s.torque_soft_factor, device=device)
        self.observations = Observations(robot, s.actor_group(), device, s.teacher_group())
        self._sensors = Sensors(s.sensing, CONTROL_PERIOD_S, episodes)
        self.events = Events(s.events, CONTROL_PERIOD_S, generator, device)
        self.rewards = RewardSum(
            s.rewards, sigma_alpha=s.sigma_alpha, adaptive=s.adaptive_sigma, step_max=s.penalty_step_max,
            dt_s=CONTROL_PERIOD_S, device=device,
        )  # fmt: skip
        self.reward_names = self.rewards.names
        self._terminations = [
            TERMINATIONS.bound(name, params) for name, params in s.termination.terms.items() if params is not None
        ]
        self.critic = Critic(s, self.observations, self._physics)
        self.curricula = {name: Curriculum(getattr(s, name)) for name in _CURRICULA}
        self.average, self.uniform_average, self._length_ratio = EpisodeAverage(), EpisodeAverage(), LengthRatio()
        self._everyone = torch.arange(self.num_envs, device=self.device)
        self.state = self._first_state()
        self.reset()

    def _first_state(self) -> EnvState:
        envs, device = self.num_envs, self.device
        clip, goal, tick, start_tick, steps = (torch.zeros(envs, dtype=torch.long, device=device) for _ in range(5))
        physics = self._physics.state()
        bodies = self._physics.bodies(physics)
        return EnvState(
            **dict(clip=clip, goal=goal, tick=tick, start_tick=start_tick, episode_steps=steps),
            uniform_start=torch.zeros(envs, dtype=torch.bool, device=device),
            last_action=torch.zeros(envs, self.num_actions, device=device),
            contact=torch.zeros(envs, 2, dtype=torch.bool, device=device),
            air_time_s=torch.zeros(envs, 2, device=device),
            position_error_m=torch.zeros_like(bodies.pos_w),
            error_change_m=torch.zeros_like(bodies.pos_w),
            **dict(zip(("actor_history", "critic_history"), self.observations.histories(envs), strict=True)),
            event_wait_s=self.events.first_waits(envs),
            gravity_b=torch.zeros(envs, 3, device=device),
            physics=physics,
            bodies=bodies,
            target=self.command.table.rows(clip, tick + 1),
            sensing=Sensing.none(envs, self.num_actions, device),
            sensed_before=senses_of(physics).clone(),
        )

    @property
    def layout(self) -> dict[str, Mapping[str, slice]]:
        """Where what lies in the observations: group → term[lag] of actor or teacher, term of the critic → columns."""
        return {**self.observations.layouts, "critic": self.critic.layout}

    @property
    def actor_group(self) -> ObservationGroup:
        """The layout of the actor's observation, as its file will state it."""
        return self.observations.group

    def reset(self) -> dict[str, torch.Tensor]:
        """Begin a new episode in every environment; return its observations."""
        self._reset(self._everyone)
        return self._observe()

    def step(self, action: torch.Tensor) -> StepResult:
        """Advance by one control period with raw actions (B, J). NonFiniteError if the physics of many diverges."""
        state = self.state
        self.disturbed = self.events.apply(state.event_wait_s, self._physics, self.simulator.randomization)
        self._physics.step(self.targets_of(action))
        self.command.advance(state, self._generator)
        t = self._after_physics(action)
        rewards = self.rewards.of(t, self.curricula["penalty_scale"].value)
        timed_out = self.command.is_over(state) & ~t.terminated
        ended = t.terminated | timed_out
        self.last_errors = tracking_errors(t)
        self._keep(t)
        self._update_curricula(t.terminated, ended)
        log = self._log()
        final_critic_obs = self.critic.view(state, timed_out.nonzero()[:, 0])
        self._reset(ended.nonzero()[:, 0])
        return StepResult(self._observe(), rewards, t.terminated, timed_out, final_critic_obs, log)

    def targets_of(self, action: torch.Tensor) -> torch.Tensor:
        """True joint positions (B, J), rad, that motors hold for raw actions: by encoders that may be off."""
        targets = decode_action(action, self.limits.default_pos_rad, ACTION_SCALE, ACTION_CLIP)
        return targets - self.state.sensing.encoder_offset_rad

    def _after_physics(self, action: torch.Tensor) -> StepOutcome:
        state = self.state
        physics, self.diverged = without_diverged(self._physics.state(), state.physics)
        bodies = self._physics.bodies(physics)
        contact = physics.foot_force_w.norm(dim=-1) > CONTACT_FORCE_N
        landed = contact | state.contact
        t = StepOutcome(
            physics=physics,
            bodies=bodies,
            reference=state.target,
            action=action,
            last_action=state.last_action,
            contact=contact,
            landed=landed,
            first_contact=landed & (state.air_time_s > 0.0),
            air_time_s=state.air_time_s + CONTROL_PERIOD_S,
            acceleration_error_m=(
                bodies.pos_w - state.target.body_pos_w - state.position_error_m - state.error_change_m
            ),
            error_limit_m=self.curricula["error_limit_m"].value,
            ground_m=self.command.table.ground_m(physics.root_pos_w[:, :2]),
            terminated=self.diverged,
            limits=self.limits,
        )
        failed = torch.stack([self.diverged, *(term(t) for term in self._terminations)])
        return replace(t, terminated=failed.any(dim=0))

    def _keep(self, t: StepOutcome) -> None:
        """Hand what the next step starts from over to it."""
        state = self.state
        state.last_action = t.action.clone()
        state.contact, state.air_time_s = t.contact, torch.where(t.landed, 0.0, t.air_time_s)
        position_error_m = t.bodies.pos_w - t.reference.body_pos_w
        state.error_change_m = position_error_m - state.position_error_m
        state.position_error_m = position_error_m
        state.sensed_before = senses_of(state.physics)
        state.physics, state.bodies = t.physics, t.bodies
        state.target = self.command.next_target(state)
        self.observations.push(state, *self._sample(self._everyone, t.reference.phase, self._generator))

    def _update_curricula(self, failed: torch.Tensor, ended: torch.Tensor) -> None:
        state, command = self.state, self.command
        self._length_ratio.update(command.length_ratio(state)[ended])
        self.average.update(state.episode_steps[ended], ~failed[ended], window=AVERAGED_EPISODES)
        uniform = ended & state.uniform_start
        self.uniform_average.update(state.episode_steps[uniform], ~failed[uniform], window=self.num_envs)
        command.update(state, failed, ended, self.last_errors["empbpe_mm"])
        self.survival_chance = float(command.failures.survival().mean())
        for curriculum in self.curricula.values():
            curriculum.update(episode_length=self.average.length, survival=self.survival_chance)

    def _log(self) -> dict[str, float]:
        """Of this step, over all environments."""
        return {
            **{name: float(values.mean()) for name, values in self.last_errors.items()},
            **errors_by_kind(self.settings.goals, self.state.goal, self.last_errors["empbpe_mm"]),
            "diverged": float(self.diverged.float().mean()),
            "episode_length_ratio": self._length_ratio.value,
            "survival_of_uniform_starts": self.uniform_average.survival,
            "survival_chance": self.survival_chance,
            **{name: self.curricula[name].value for name in ("error_limit_m", "penalty_scale")},
            "randomization": self.simulator.randomization,
            **{f"sigma/{name}": float(v) for name, v in zip(self.rewards.sigma.names, self.rewards.sigma.sigma)},
        }

    def figures(self) -> dict[str, float]:
        """What is known of each clip; see :meth:`train.mdp.command.Command.figures`."""
        return self.command.figures()

    def _reset(self, env_ids: torch.Tensor) -> None:
        if len(env_ids) == 0:
            return
        state, start = self.state, self.command.draw(env_ids)
        self._physics.reset(env_ids, start.qpos, start.qvel)
        self.command.begin(state, env_ids, start)
        state.last_action[env_ids] = 0.0
        state.contact[env_ids], state.air_time_s[env_ids] = False, 0.0
        physics = self._physics.state().rows(env_ids)
        bodies = self._physics.bodies(physics)
        state.physics.write(env_ids, physics)
        state.bodies.write(env_ids, bodies)
        self._sensors.begin(state, env_ids, self.simulator.randomization)
        state.position_error_m[env_ids] = bodies.pos_w - start.rows.body_pos_w
        state.error_change_m[env_ids] = CONTROL_PERIOD_S * (bodies.lin_vel_w - start.rows.body_lin_vel_w)
        self.observations.restart(state, env_ids, *self._sample(env_ids, start.rows.phase, self._episodes))

    def _sample(
        self, rows: torch.Tensor, phase: torch.Tensor, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Samples of the robots ``rows`` (n,). Sensor noise grows with the randomisation."""
        state = self.state
        window = self.command.window(state, rows, self.observations.window_ticks)
        senses = self._sensors.senses(state, rows, self.simulator.randomization, generator)
        state.gravity_b[rows] = senses.filtered(state.gravity_b[rows], state.episode_steps[rows], CONTROL_PERIOD_S)
        given = senses, state.gravity_b[rows], state.last_action[rows], phase, window
        return self.observations.sample(state.physics.rows(rows), *given)

    def _observe(self) -> dict[str, torch.Tensor]:
        return {
            **self.observations.groups(self.state.actor_history),
            "critic": self.critic.view(self.state, self._everyone),
        }

    def finish_iteration(self) -> None:
        """Apply what changes between iterations only, as it touches every model: the width of the randomisation."""
        wanted, hard = self.curricula["randomization_scale"].value, self.settings.randomization_scale.hard
        step = abs(wanted - self.simulator.randomization)
        if step >= RANDOMIZATION_STEP or (step > 0.0 and wanted == hard):
            self.simulator.set_randomization(wanted)
            self.rewards.sigma.restart()

    def follow(self, leader: "TrackingEnv", rows: torch.Tensor) -> None:
        """Take the robots of ``rows`` (B,) bool to where ``leader``'s are, and all that is nobody's own with them."""
        for own, its in zip(self.simulator.robots(), leader.simulator.robots(), strict=True):
            own[rows] = its[rows]
        self.state.copy_rows(leader.state, rows)
        self._load_common(leader._common())

    def _common(self) -> dict[str, Any]:
        """What is nobody's own, as tensors and plain numbers."""
        return {
            "sigma": self.rewards.sigma.state_dict(),
            "command": self.command.state_dict(),
            "curricula": {name: curriculum.value for name, curriculum in self.curricula.items()},
            "averages": {name: dict(vars(getattr(self, name))) for name in _AVERAGES},
            "generators": [generator.get_state() for generator in self._generators],
        }

    def _load_common(self, state: dict[str, Any]) -> None:
        self.rewards.sigma.load_state_dict(state["sigma"])
        self.command.load_state_dict(state["command"])
        for name, curriculum in self.curricula.items():
            curriculum.value = state["curricula"][name]
        for name, values in state["averages"].items():
            vars(getattr(self, name)).update(values)
        for generator, value in zip(self._generators, state["generators"], strict=True):
            generator.set_state(value)

    def state_dict(self) -> dict[str, Any]:
        """Everything that a continued run needs, as tensors and plain numbers."""
        return {"simulator": self.simulator.state_dict(), "state": self.state.state_dict(), **self._common()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`state_dict` returned."""
        self.simulator.load_state_dict(state["simulator"])
        self.state.load_state_dict(state["state"])
        self._load_common(state)


_AVERAGES = ("average", "uniform_average", "_length_ratio")
_CURRICULA = ("error_limit_m", "penalty_scale", "randomization_scale")
