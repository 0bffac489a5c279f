"""Backends by name."""

from pathlib import Path

import numpy as np

from hal.backend import Backend
from hal.clock import Clock
from hal.mock import MockBackend, MockOptions
from hal.mujoco import MujocoBackend
from hal.options import config_file, load_options
from hal.sim_options import SimOptions, load_sim_options
from robot.errors import InputError
from robot.robot import Robot

BACKENDS = ("mock", "mujoco")


def open_backend(
    name: str,
    robot: Robot,
    clock: Clock,
    *,
    control_period_s: float = 0.02,
    config: str | Path | None = None,
    sim: str | Path | SimOptions = "default",
    sim_model: Path | None = None,
    band: bool = True,
    meshes: Path | None = None,
    rng: np.random.Generator | None = None,
) -> Backend:
    """Build the backend `name`; entering it connects.

    config: file or name in configs/hal (mock). sim, sim_model, band, meshes, rng: see MujocoBackend; sim may be a
    name in configs/sim, a file, or the options themselves. Raises InputError on an unknown name or an unusable option.
    """
    if name == "mock":
        if sim_model is not None:
            raise InputError("a simulation model", where="backend mock", got=sim_model, expected="--backend mujoco")
        options = load_options(MockOptions, config_file("hal", config or "mock"))
        return MockBackend(robot, clock, options, control_period_s=control_period_s)
    if name == "mujoco":
        sim_options = sim if isinstance(sim, SimOptions) else load_sim_options(sim)
        return MujocoBackend(
            robot,
            clock,
            sim_options,
            control_period_s=control_period_s,
            sim_model=sim_model,
            band=band,
            meshes=meshes,
            rng=rng,
        )
    raise InputError("unknown backend", got=name, expected=f"one of {', '.join(BACKENDS)}")
