"""Backends and small motions that the tests of hal share."""

import dataclasses
from typing import Any

import numpy as np

from core.clock import SimulatedClock
from core.config import config_file, load_options
from hal.contract.backend import Backend
from hal.contract.types import RobotState
from hal.simulated.faults import MockFault
from hal.simulated.mock import MockBackend, MockOptions
from hal.simulated.mujoco import MujocoBackend
from robot.robot import Robot, load_robot
from world.actuation import JointCommand
from world.options import SimOptions, load_sim_options

PERIOD_S = 0.02
G1 = load_robot()
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def sim_options(name: str = "default", **changes: Any) -> SimOptions:
    return dataclasses.replace(load_sim_options(name), **changes)


def mock(*faults: MockFault, robot: Robot = G1, **changes: Any) -> MockBackend:
    options = load_options(MockOptions, config_file("hal", "mock"))
    return MockBackend(robot, SimulatedClock(), dataclasses.replace(options, faults=faults, **changes))


def mujoco_backend(
    *, robot: Robot = G1, gantry: bool = False, seed: int = 0, sim: str = "default", **changes: Any
) -> MujocoBackend:
    rng = np.random.default_rng(seed)
    return MujocoBackend(robot, SimulatedClock(), sim_options(sim, **changes), gantry=gantry, rng=rng)


def hold(robot: Robot, target_rad: np.ndarray | None = None, kp_scale: float = 1.0) -> JointCommand:
    zero = np.zeros(robot.num_joints)
    target = robot.default_pos_rad if target_rad is None else target_rad
    return JointCommand(target.copy(), zero, robot.kp * kp_scale, robot.kd.copy(), zero)


def pass_time(backend: Any, seconds: float) -> None:
    backend.clock.sleep_until(backend.clock.now_s() + seconds)


def run(backend: Backend, command: JointCommand, seconds: float) -> RobotState:
    """Write the command and read once per period; the last state."""
    for _ in range(round(seconds / PERIOD_S)):
        backend.write(command)
        pass_time(backend, PERIOD_S)
        state = backend.read()
    return state
