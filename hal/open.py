"""Backends by name."""

import hashlib
import importlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from core.clock import Clock
from core.config import config_file, load_options
from core.errors import InputError
from hal.contract.backend import Backend
from hal.emulator.launch import Emulator
from hal.simulated.mock import MockBackend, MockOptions
from hal.simulated.mujoco import MujocoBackend
from hal.wire.backend import WireBackend
from hal.wire.driver import WireFactory
from hal.wire.emulated import EmulatedWireBackend
from robot.robot import Robot
from world.options import SimOptions, load_sim_options
from world.scene import FLAT, Scene

# name -> module of the driver, and the name of its configuration in configs/hal where none is given. The module's
# `make_factory(config: Path, endpoints: Mapping[str, str]) -> WireFactory` reads the configuration (InputError where
# it is unusable) and opens nothing; endpoints say where to connect instead: what `Emulator.endpoints` says, and for
# dds `interface`, `domain` and `peer`.
WIRES = {
    "dds": ("hal.dds.driver", "dds"),
    "can": ("hal.can.driver", "can_g1"),
    "dynamixel": ("hal.dynamixel.driver", "dynamixel_g1"),
}
BACKENDS = ("mock", "mujoco", *WIRES)


def open_backend(
    name: str,
    robot: Robot,
    clock: Clock,
    *,
    control_period_s: float = 0.02,
    config: str | Path | None = None,
    sim: str | Path | SimOptions = "default",
    scene: Scene = FLAT,
    sim_model: Path | None = None,
    gantry: bool = True,
    meshes: Path | None = None,
    rng: np.random.Generator | None = None,
    endpoints: Mapping[str, str] | None = None,
    emulator: Emulator | None = None,
) -> Backend:
    """Build the backend `name`; entering it connects.

    config: file or name in configs/hal (not mujoco). sim, scene, sim_model, gantry, meshes, rng: see MujocoBackend; sim
    may be a name in configs/world, a file, or the options themselves. endpoints: where a wire connects, instead of
    what its configuration says; emulator: the running other end of a wire, which adds its own endpoints. Raises
    InputError on an unknown name or an unusable option.
    """
    if name in WIRES:
        wire = (config, endpoints or {}, emulator)
        return _open_wire(name, robot, clock, *wire, control_period_s=control_period_s)
    if name == "mock":
        if sim_model is not None:
            raise InputError("a simulation model", where="backend mock", got=sim_model, expected="--backend mujoco")
        options = load_options(MockOptions, config_file("hal", config or "mock"))
        return MockBackend(robot, clock, options, control_period_s=control_period_s)
    if name == "mujoco":
        if config is not None:
            raise InputError("a hal configuration", where="backend mujoco", got=config, hint="it is configured by sim")
        sim_options = sim if isinstance(sim, SimOptions) else load_sim_options(sim)
        return MujocoBackend(
            robot, clock, sim_options, control_period_s=control_period_s, scene=scene, sim_model=sim_model,
            gantry=gantry, meshes=meshes, rng=rng,
        )  # fmt: skip
    raise InputError("unknown backend", got=name, expected=f"one of {', '.join(BACKENDS)}")


def _open_wire(
    name: str,
    robot: Robot,
    clock: Clock,
    config: str | Path | None,
    endpoints: Mapping[str, str],
    emulator: Emulator | None,
    *,
    control_period_s: float,
) -> Backend:
    factory = wire_factory(name, config, {**(emulator.endpoints if emulator else {}), **endpoints})
    label = f"{name}, peer {endpoints['peer']}" if "peer" in endpoints else name
    times = {"control_period_s": control_period_s, "link_timeout_s": factory.link_timeout_s}
    if emulator is not None:
        return EmulatedWireBackend(label, robot, clock, factory, emulator, **times, keep_pace=True)
    return WireBackend(label, robot, clock, factory, wires=factory.wires, **times)


def wire_config(name: str, config: str | Path | None = None) -> Path:
    """The configuration file of a wire; None: the one that it ships with. Raises InputError where there is none."""
    return config_file("hal", config or WIRES[name][1])


def wire_config_sha256(name: str, config: str | Path | None, endpoints: Mapping[str, str]) -> str:
    """What identifies a wire's set-up: the content of its configuration and where it connects instead."""
    content = hashlib.sha256(wire_config(name, config).read_bytes())
    content.update(repr((name, sorted(endpoints.items()))).encode())
    return content.hexdigest()


def wire_factory(name: str, config: str | Path | None, endpoints: Mapping[str, str]) -> WireFactory:
    """What builds the driver in the wire process. Raises InputError on an unusable configuration."""
    factory: WireFactory = importlib.import_module(WIRES[name][0]).make_factory(wire_config(name, config), endpoints)
    return factory
