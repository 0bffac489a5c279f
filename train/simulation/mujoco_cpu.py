"""Batched physics on CPU cores: MuJoCo's threaded rollout with one model per environment.

PD control is MuJoCo's position actuator (force limited to the joint's torque limit); control delay and torque
disturbance are in the targets of each sub-step, so that no Python runs between sub-steps. A disturbance τ moves a
target by τ/kp: it adds to the motor's torque before the limit.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
import torch
from mujoco.rollout import Rollout

from robot.robot import Robot
from train.simulation.domain import Domain, DomainRanges, draw_domain, nominal_domain, uniform
from train.simulation.model import SimulationSettings, training_model
from train.simulation.simulator import PhysicsState
from world.scene import FLAT, Scene

_GAINS = ("kp_scale", "kd_scale")
_STATE_SPEC = mujoco.mjtState.mjSTATE_FULLPHYSICS
_CONTROL_SPEC = mujoco.mjtState.mjSTATE_CTRL


class MujocoCpuSimulator:
    """B robots in one scene.

    Args:
        robot: the robot.
        num_envs: B.
        ranges: what differs between environments.
        generator: source of what environments and each step draw.
        episodes: source of what each episode draws.
        scene: what the robots stand in.
        settings: how finely physics is stepped, and what differs from the robot's description.
        control_period_s: duration of one :meth:`step`.
        threads: worker threads.
        randomization: start value of :meth:`set_randomization`.
    """

    def __init__(
        self,
        robot: Robot,
        num_envs: int,
        ranges: DomainRanges,
        generator: torch.Generator,
        episodes: torch.Generator,
        *,
        scene: Scene = FLAT,
        settings: SimulationSettings,
        control_period_s: float = 0.02,
        threads: int = 2,
        randomization: float = 1.0,
    ) -> None:
        self.num_envs, self.generator, self.episodes = num_envs, generator, episodes
        self._robot, self._ranges = robot, ranges
        self._substeps, self._substep_s = settings.substeps, control_period_s / settings.substeps
        self._sensed = [*robot.feet, *robot.penalized_contact_bodies]
        model = training_model(robot, settings, scene=scene, timestep_s=self._substep_s, sensed=self._sensed)
        self._nominal_model = model
        self._nominal = nominal_domain(num_envs, robot)
        self._differs = (torch.arange(num_envs) >= round(ranges.nominal_share * num_envs)).float()
        self._drawn = draw_domain(num_envs, robot, ranges, generator)
        self._models = [copy.copy(model) for _ in range(num_envs)]
        self._rollout = Rollout(nthread=threads)
        self._data = [mujoco.MjData(model) for _ in range(max(1, threads))]
        self._allocate(model)
        self.set_randomization(randomization)

    def _allocate(self, model: mujoco.MjModel) -> None:
        envs, steps = self.num_envs, self._substeps
        size = mujoco.mj_stateSize(model, _STATE_SPEC)
        self._nq, self._nv, self._nu = model.nq, model.nv, model.nu
        self._state = torch.zeros(envs, size, dtype=torch.float64)
        self._trajectory = torch.zeros(envs, steps, size, dtype=torch.float64)
        self._sensors = torch.zeros(envs, steps, model.nsensordata, dtype=torch.float64)
        self._control = torch.zeros(envs, steps, self._nu, dtype=torch.float64)
        reach = -(-round(self._ranges.delay_s[1] / self._substep_s) // steps)
        default = torch.as_tensor(self._robot.default_pos_rad.copy(), dtype=torch.float32)
        self._targets = default.repeat(envs, reach + 1, 1)
        self._lag = torch.zeros(envs, steps, dtype=torch.long)
        self._kp = torch.as_tensor(self._robot.kp.copy(), dtype=torch.float32)
        self._torque_limit = torch.as_tensor(self._robot.torque_limit_nm.copy(), dtype=torch.float32)
        self._torque_offset = torch.zeros(envs, self._robot.num_joints)
        self._torque_noise = torch.zeros(envs, 1, self._robot.num_joints)
        self._fresh = torch.ones(envs, dtype=torch.bool)
        self._written_gains = torch.ones(envs, 2 * self._nu)

    def set_randomization(self, scale: float) -> None:
        """Move the model of every environment that differs to nominal + scale·(drawn − nominal)."""
        self.randomization = scale
        self.domain = self._drawn.towards(self._nominal, scale * self._differs)
        _write_models(self._models, self._nominal_model, self._robot, self.domain)

    def redraw(self) -> None:
        """See :class:`train.simulation.simulator.Simulator`."""
        gains = {name: getattr(self._drawn, name) for name in _GAINS}
        self._drawn = replace(draw_domain(self.num_envs, self._robot, self._ranges, self.generator), **gains)
        self.set_randomization(self.randomization)

    @property
    def delay_s(self) -> torch.Tensor:
        """(B,) control delay of the present episodes, seconds."""
        return self._lag.sum(dim=1) * self._substep_s  # a lag of n control steps lasts n·substeps in all

    @property
    def torque_offset_nm(self) -> torch.Tensor:
        """(B, J) what is added to the motors' torques in the present episodes, before their limit."""
        return self._torque_offset * self.randomization

    def reset(self, env_ids: torch.Tensor, qpos: torch.Tensor, qvel: torch.Tensor) -> None:
        """See :class:`train.simulation.simulator.Simulator`."""
        self._state[env_ids] = torch.cat([torch.zeros(len(env_ids), 1), qpos, qvel], dim=1).double()
        self._sensors[env_ids] = 0.0
        self._fresh[env_ids] = True
        self._draw_episode(env_ids)

    def _draw_episode(self, env_ids: torch.Tensor) -> None:
        count, ranges, joints = len(env_ids), self._ranges, self._robot.num_joints
        differs = self._differs[env_ids, None]
        delay = torch.round(self._draw_delay(count) * differs[:, 0] * self.randomization / self._substep_s)
        late = delay[:, None] - torch.arange(self._substeps)  # sub-steps until the newest command arrives
        self._lag[env_ids] = torch.ceil(late.clamp(min=0) / self._substeps).long()
        offset = uniform((count, joints), -1.0, 1.0, self.episodes) * ranges.torque_offset
        self._torque_offset[env_ids] = offset * differs * self._torque_limit
        noise = uniform((count, 1, joints), *ranges.torque_noise_scale, self.episodes) * ranges.torque_noise
        self._torque_noise[env_ids] = noise * differs[..., None]
        for name in _GAINS:
            low, high = getattr(ranges, name)
            drawn = uniform((count, joints), low, high, self.episodes)
            getattr(self._drawn, name)[env_ids] = drawn
            getattr(self.domain, name)[env_ids] = 1.0 + self.randomization * differs * (drawn - 1.0)

    def _write_gains(self) -> None:
        """Write the episodes' gains into the models that have others."""
        gains = torch.cat([getattr(self.domain, name) for name in _GAINS], dim=1)
        nominal = self._nominal_model
        for env in (gains != self._written_gains).any(dim=1).nonzero()[:, 0].tolist():
            kp_scale, kd_scale = gains[env].double().numpy().reshape(2, -1)
            gain, bias = self._models[env].actuator_gainprm, self._models[env].actuator_biasprm
            gain[:, 0] = nominal.actuator_gainprm[:, 0] * kp_scale
            bias[:, 1] = nominal.actuator_biasprm[:, 1] * kp_scale
            bias[:, 2] = nominal.actuator_biasprm[:, 2] * kd_scale
        self._written_gains = gains

    def _draw_delay(self, count: int) -> torch.Tensor:
        """Control delays (count,), seconds: anything in the range, or its whole control steps."""
        low, high = self._ranges.delay_s
        if not self._ranges.delay_whole_steps:
            return uniform((count,), low, high, self.episodes)
        period_s = self._substeps * self._substep_s
        first, last = round(low / period_s), round(high / period_s)
        return torch.floor(uniform((count,), first, last + 1, self.episodes)) * period_s

    def push(self, env_ids: torch.Tensor, velocity_w: torch.Tensor) -> None:
        """See :class:`train.simulation.simulator.Simulator`."""
        start = 1 + self._nq
        self._state[env_ids, start : start + 2] += velocity_w.double()

    def step(self, targets: torch.Tensor) -> None:
        """See :class:`train.simulation.simulator.Simulator`."""
        self._targets = torch.cat([targets[:, None], self._targets[:, :-1]], dim=1)
        # A new episode has no earlier command: its queue holds the first one.
        self._targets = torch.where(self._fresh[:, None, None], targets[:, None], self._targets)
        self._fresh[:] = False
        joints = self._targets.shape[-1]
        delayed = self._targets.gather(1, self._lag[..., None].expand(-1, -1, joints))
        noise = uniform((self.num_envs, self._substeps, joints), -1.0, 1.0, self.generator)
        disturbance = self._torque_offset[:, None] + noise * self._torque_noise * self._torque_limit
        kp = self._kp * self.domain.kp_scale[:, None]
        self._control[:] = delayed + disturbance * self.randomization / kp
        self._write_gains()
        self._rollout.rollout(
            self._models,
            self._data,
            self._state.numpy(),
            self._control.numpy(),
            control_spec=_CONTROL_SPEC,
            skip_checks=True,
            nstep=self._substeps,
            state=self._trajectory.numpy(),
            sensordata=self._sensors.numpy(),
        )
        last = self._trajectory[:, -1]
        # What MuJoCo itself calls diverged is marked for whoever looks at the state.
        self._state.copy_(torch.where(last.abs() <= mujoco.mjMAXVAL, last, torch.nan))

    def state(self) -> PhysicsState:
        """See :class:`train.simulation.simulator.Simulator`."""
        values = self._state[:, 1:].float()
        qpos, qvel = values[:, : self._nq], values[:, self._nq : self._nq + self._nv]
        # Contact sensors are the last ones, after those of torques; they give the force that the body exerts.
        contacts = 3 * len(self._sensed)
        torque, force = self._sensors[:, -1, -contacts - self._nu :].float().split([self._nu, contacts], dim=1)
        force = -force.unflatten(1, (-1, 3))
        return PhysicsState(
            root_pos_w=qpos[:, :3],
            root_quat_wxyz=qpos[:, 3:7],
            root_lin_vel_w=qvel[:, :3],
            root_ang_vel_b=qvel[:, 3:6],
            joint_pos_rad=qpos[:, 7:],
            joint_vel_rad_s=qvel[:, 6:],
            torque_nm=torque,
            foot_force_w=force[:, :2],
            body_force_n=force[:, 2:].norm(dim=-1),
        )

    def robots(self) -> list[torch.Tensor]:
        """See :class:`train.simulation.simulator.Simulator`."""
        drawn = [getattr(domain, name) for domain in (self._drawn, self.domain) for name in _GAINS]
        return [*self._own(), *drawn]

    def _own(self) -> list[torch.Tensor]:
        return [getattr(self, name) for name in self._CHECKPOINTED]

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Physics state, queues and draws (the rollout starts its solver cold: no warm start to keep)."""
        return (
            {name: value.clone() for name, value in zip(self._CHECKPOINTED, self._own(), strict=True)}
            | {"randomization": torch.tensor(self.randomization, dtype=torch.float64)}
            | {f"drawn.{name}": value.clone() for name, value in vars(self._drawn).items()}
        )

    _CHECKPOINTED = (
        "_state", "_sensors", "_targets", "_lag", "_torque_offset", "_torque_noise", "_fresh",
    )  # fmt: skip

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what :meth:`state_dict` returned."""
        for name in self._CHECKPOINTED:
            getattr(self, name).copy_(state[name])
        drawn = Domain(**{key[6:]: value.clone() for key, value in state.items() if key.startswith("drawn.")})
        scale = float(state["randomization"])
        if scale != self.randomization or not drawn.equals(self._drawn):  # to write the models takes long
            self._drawn = drawn
            self.set_randomization(scale)


def _write_models(models: Sequence[mujoco.MjModel], nominal: mujoco.MjModel, robot: Robot, domain: Domain) -> None:
    """Write the environments' parameters, but for gains, into their models; refresh MuJoCo's derived constants."""
    bodies = np.array([nominal.body(name).id for name in robot.randomized_mass_bodies])
    torso = nominal.body(robot.randomized_com_body).id
    feet = {nominal.body(name).id for name in robot.feet}
    foot_geoms = np.array([g for g in range(nominal.ngeom) if nominal.geom_bodyid[g] in feet])
    sole, centre = _sole(nominal, robot)
    from_centre = nominal.geom_pos[sole, :2] - centre
    scratch = mujoco.MjData(nominal)
    values = {name: value.double().numpy() for name, value in vars(domain).items()}
    for env, model in enumerate(models):
        model.body_mass[bodies] = nominal.body_mass[bodies] * values["mass_scale"][env]
        model.body_inertia[bodies] = nominal.body_inertia[bodies] * values["inertia_scale"][env][:, None]
        model.body_ipos[torso] = nominal.body_ipos[torso] + values["com_offset_m"][env]
        model.geom_friction[foot_geoms, 0] = values["friction"][env]
        model.geom_pos[sole, :2] = centre + values["sole_scale"][env][:, None] * from_centre
        mujoco.mj_setConst(model, scratch)


def _sole(model: mujoco.MjModel, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """The spheres (P,) of both soles, and for each the centre (P, 2) of its sole in the foot's frame."""
    spheres, centres = [], []
    for name in robot.feet:
        of_foot = (model.geom_bodyid == model.body(name).id) & (model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE)
        spheres.append(np.flatnonzero(of_foot))
        centres.append(np.repeat(model.geom_pos[of_foot, :2].mean(axis=0, keepdims=True), of_foot.sum(), axis=0))
    return np.concatenate(spheres), np.concatenate(centres)
