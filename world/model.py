"""MuJoCo models of a robot: its MJCF with a floor, lights and actuators added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco

from core.errors import InputError
from robot.robot import Robot
from world import appearance
from world.actuation import add_motors
from world.scene import FLAT, Scene, add_scene

NET_FORCE = 3  # the contact sensor's reduction that sums all contacts, in the world frame


def build_spec(robot: Robot, *, scene: Scene = FLAT, meshes: Path | None = None) -> mujoco.MjSpec:
    """The robot's MJCF as an editable spec without actuators, in the scene, with sky and light.

    ``meshes`` is a folder with the maker's STL files: bodies that have one there show it.
    Raises InputError when that folder is of no use.
    """
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    if meshes is not None:
        appearance.add_meshes(spec, robot, Path(meshes))
    add_scene(spec, scene)
    appearance.add_sky_and_light(spec)
    return spec


def compile_model(
    robot: Robot,
    *,
    timestep_s: float,
    scene: Scene = FLAT,
    meshes: Path | None = None,
    actuation: str = "torque",
    strip_visuals: bool = False,
    edit: Callable[[mujoco.MjSpec], None] | None = None,
) -> mujoco.MjModel:
    """A model with one actuator per joint in joint table order, stepped every ``timestep_s``.

    ``actuation``: a law of `world.actuation`. ``strip_visuals`` leaves out what physics does not see. ``edit`` gets
    the spec last, before it is compiled. Raises InputError on a time step that is not positive, an unknown
    actuation, or meshes that cannot be used.
    """
    spec = build_spec(robot, scene=scene, meshes=meshes)
    if strip_visuals:
        appearance.strip_visuals(spec)
    where = str(robot.mjcf_path) if meshes is None else f"meshes {meshes}"
    fault = "does not compile" if meshes is None else "a mesh cannot be read"
    return compile_spec(spec, robot, timestep_s=timestep_s, actuation=actuation, edit=edit, where=where, fault=fault)


def compile_spec(
    spec: mujoco.MjSpec,
    robot: Robot,
    *,
    timestep_s: float,
    actuation: str,
    where: str,
    edit: Callable[[mujoco.MjSpec], None] | None = None,
    fault: str = "does not compile",
) -> mujoco.MjModel:
    """Add time step, motors and what ``edit`` does, and compile. Raises InputError: ``where``, ``fault``."""
    if not timestep_s > 0:
        raise InputError("timestep_s", got=timestep_s, expected="a positive number of seconds")
    spec.option.timestep = timestep_s
    add_motors(spec, robot, actuation)
    if edit is not None:
        edit(spec)
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError(fault, where=where, got=" ".join(str(error).split())) from error


def add_contact_sensors(spec: mujoco.MjSpec, bodies: Sequence[str]) -> None:
    """For each body a sensor of the net contact force (3,) that it exerts, N, in the world frame."""
    for body in bodies:
        spec.add_sensor(
            name=f"contact_{body}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=body,
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), NET_FORCE, 1],
        )


def first_line(error: Exception) -> str:
    """What MuJoCo says first."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def check_meshes(robot: Robot, folder: Path) -> None:
    """Raise InputError unless the maker's meshes in ``folder`` can be shown on the robot."""
    compile_model(robot, timestep_s=0.001, meshes=folder)
