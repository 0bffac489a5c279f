"""MuJoCo models of a robot: its MJCF with a floor, lights and actuators added."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import mujoco

from core.errors import InputError
from robot.robot import Robot
from world import appearance
from world.scene import FLAT, Scene, add_scene

Actuation = Literal["torque", "position"]


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
    actuation: Actuation = "torque",
    strip_visuals: bool = False,
    edit: Callable[[mujoco.MjSpec], None] | None = None,
) -> mujoco.MjModel:
    """A model with one actuator per joint in joint table order, stepped every ``timestep_s``.

    ``torque``: ctrl in Nm. ``position``: ctrl is the target q* in rad, force kp (q* - q) - kd q̇. Both are
    clipped at the torque limit. ``strip_visuals`` leaves out what physics does not see. ``edit`` gets the
    spec last, before it is compiled. Raises InputError on a time step that is not positive, an unknown
    actuation, or meshes that cannot be used.
    """
    if not timestep_s > 0:
        raise InputError("timestep_s", got=timestep_s, expected="a positive number of seconds")
    spec = build_spec(robot, scene=scene, meshes=meshes)
    spec.option.timestep = timestep_s
    for i in range(robot.num_joints):
        _add_actuator(spec, robot, i, actuation)
    if strip_visuals:
        appearance.strip_visuals(spec)
    if edit is not None:
        edit(spec)
    if meshes is None:
        return spec.compile()
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError("a mesh cannot be read", where=f"meshes {meshes}", got=" ".join(str(error).split())) from error


def check_meshes(robot: Robot, folder: Path) -> None:
    """Raise InputError unless the maker's meshes in ``folder`` can be shown on the robot."""
    compile_model(robot, timestep_s=0.001, meshes=folder)


def _add_actuator(spec: mujoco.MjSpec, robot: Robot, i: int, actuation: Actuation) -> None:
    limit = float(robot.torque_limit_nm[i])
    actuator = spec.add_actuator(name=robot.joint_names[i], target=robot.joint_names[i])
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.forcelimited = True
    actuator.forcerange = [-limit, limit]
    if actuation == "torque":
        actuator.set_to_motor()
        actuator.ctrllimited = True
        actuator.ctrlrange = [-limit, limit]
    elif actuation == "position":
        actuator.set_to_position(kp=float(robot.kp[i]), kv=float(robot.kd[i]))
        actuator.ctrllimited = False
    else:
        raise InputError("unknown actuation", got=actuation, expected="torque or position")
