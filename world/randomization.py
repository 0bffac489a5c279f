"""What one simulated episode is like, drawn from the options by the episode's generator."""

from dataclasses import dataclass

import numpy as np

from robot.robot import Robot
from world.domain import Range
from world.options import SensorNoise, SimOptions


@dataclass(frozen=True)
class Conditions:
    """Everything about an episode that is not the robot's nominal model.

    friction: effective sliding friction of every contact, None for the model's own. mass_scale, inertia_scale: (B,)
    over `robot.randomized_mass_bodies`. kp_scale, kd_scale, torque_offset_nm, torque_noise_nm (half width): (J,).
    """

    friction: float | None
    command_delay_s: float
    push_speed_m_s: float
    push_interval_s: Range
    noise: SensorNoise
    mass_scale: np.ndarray
    inertia_scale: np.ndarray
    torso_com_shift_m: np.ndarray
    kp_scale: np.ndarray
    kd_scale: np.ndarray
    torque_offset_nm: np.ndarray
    torque_noise_nm: np.ndarray


def draw_conditions(options: SimOptions, robot: Robot, rng: np.random.Generator) -> Conditions:
    """The conditions of one episode; a figure given in `options` holds also where the rest is drawn."""
    if not options.randomize:
        return _nominal(options, robot)
    r, joints, bodies = options.randomization, robot.num_joints, len(robot.randomized_mass_bodies)
    limit_nm = robot.torque_limit_nm
    friction, delay_s = rng.uniform(*r.friction), rng.uniform(*r.delay_s)
    return Conditions(
        friction=friction if options.friction is None else options.friction,
        command_delay_s=delay_s if options.command_delay_s is None else options.command_delay_s,
        push_speed_m_s=r.push_speed_m_s if options.push_speed_m_s is None else options.push_speed_m_s,
        push_interval_s=r.push_interval_s if options.push_speed_m_s is None else _fixed(options.push_interval_s),
        noise=r.noise,
        mass_scale=rng.uniform(*r.mass_scale, bodies),
        inertia_scale=rng.uniform(*r.inertia_scale, bodies),
        torso_com_shift_m=rng.uniform(-1.0, 1.0, 3) * (r.com_xy_m, r.com_xy_m, r.com_z_m),
        kp_scale=rng.uniform(*r.kp_scale, joints),
        kd_scale=rng.uniform(*r.kd_scale, joints),
        torque_offset_nm=rng.uniform(-1.0, 1.0, joints) * r.torque_offset * limit_nm,
        torque_noise_nm=rng.uniform(*r.torque_noise_scale, joints) * r.torque_noise * limit_nm,
    )


def _nominal(options: SimOptions, robot: Robot) -> Conditions:
    joints, bodies = robot.num_joints, len(robot.randomized_mass_bodies)
    return Conditions(
        friction=options.friction,
        command_delay_s=options.command_delay_s or 0.0,
        push_speed_m_s=options.push_speed_m_s or 0.0,
        push_interval_s=_fixed(options.push_interval_s),
        noise=options.noise,
        mass_scale=np.ones(bodies),
        inertia_scale=np.ones(bodies),
        torso_com_shift_m=np.zeros(3),
        kp_scale=np.ones(joints),
        kd_scale=np.ones(joints),
        torque_offset_nm=np.zeros(joints),
        torque_noise_nm=np.zeros(joints),
    )


def _fixed(interval_s: float) -> Range:
    return (interval_s, interval_s)
