"""The MuJoCo model of the robot with its motors: this project's own, or any MJCF with the same joints."""

from pathlib import Path

import mujoco

from core.errors import InputError
from robot.robot import Robot
from world.gantry import add_straps
from world.model import build_spec
from world.options import SimOptions
from world.scene import FLAT, Scene, add_boxes


def build_plant_model(
    robot: Robot,
    options: SimOptions,
    *,
    scene: Scene = FLAT,
    sim_model: Path | None = None,
    band: bool = False,
    meshes: Path | None = None,
) -> mujoco.MjModel:
    """Compile the robot (or the MJCF `sim_model`) with one PD motor per joint, in joint-table order.

    A motor's force is ctrl - kp q - kd dq, clipped at the torque limit of the joint table; kp and kd are in `biasprm`.
    `scene`: of a `sim_model`, whose ground is its own, the boxes alone.
    `meshes`: a folder with the maker's, to be seen on the robot's own model; physics does not notice them.
    The integrator is Euler, in which actuator forces are explicit: computed from the state at the step's start.
    Raises InputError where the file is missing or does not fit the robot.
    """
    spec = build_spec(robot, scene=scene, meshes=meshes) if sim_model is None else _read_spec(sim_model, robot, scene)
    spec.option.timestep = options.timestep_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for name, limit_nm in zip(robot.joint_names, robot.torque_limit_nm):
        _add_motor(spec, name, float(limit_nm))
    if band:
        add_straps(spec, robot, options.band)
    try:
        return spec.compile()
    except ValueError as error:
        raise InputError(f"does not compile: {_first_line(error)}", where=sim_model or robot.mjcf_path) from error


def _add_motor(spec: mujoco.MjSpec, joint: str, limit_nm: float) -> None:
    motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.dyntype = mujoco.mjtDyn.mjDYN_NONE
    motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    motor.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    motor.gainprm[:3] = [1.0, 0.0, 0.0]
    motor.biasprm[:3] = [0.0, 0.0, 0.0]
    motor.ctrllimited = False
    motor.forcelimited, motor.forcerange = True, [-limit_nm, limit_nm]


def _read_spec(path: Path, robot: Robot, scene: Scene) -> mujoco.MjSpec:
    if not path.is_file():
        raise InputError("no such file", where=f"simulation model {path}", expected="an MJCF with the robot's joints")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise InputError(f"is no MJCF: {_first_line(error)}", where=f"simulation model {path}") from error
    _check_fit(spec, robot, f"simulation model {path}")
    if scene.floor_m != 0.0:
        raise InputError("a floor of another height", where=f"simulation model {path}", got=f"{scene.floor_m} m")
    # The motors are the robot's own; what refers to the file's actuators goes with them.
    for element in [*spec.actuators, *spec.sensors, *spec.keys]:
        spec.delete(element)
    add_boxes(spec, scene)
    return spec


def _check_fit(spec: mujoco.MjSpec, robot: Robot, where: str) -> None:
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) != 1:
        raise InputError("number of free joints", where=where, got=len(free), expected="1, the robot's root")
    hinges = {joint.name: joint for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE}
    missing = [name for name in robot.joint_names if name not in hinges]
    extra = [name or "(no name)" for name in hinges if name not in robot.joint_names]
    faults = [f"{kind} joints {', '.join(names)}" for kind, names in (("missing", missing), ("extra", extra)) if names]
    if faults:
        raise InputError("; ".join(faults), where=where, expected=f"the joints of {robot.name}")
    if wrong := [name for name, joint in hinges.items() if joint.type != mujoco.mjtJoint.mjJNT_HINGE]:
        raise InputError("joints that are no hinges", where=where, got=", ".join(wrong))
    bodies = [body.name for body in spec.bodies]
    needed = dict.fromkeys((robot.root_body, *robot.feet, *robot.randomized_mass_bodies, robot.randomized_com_body))
    if absent := [name for name in needed if name not in bodies]:
        raise InputError(f"missing bodies {', '.join(absent)}", where=where, expected=f"the bodies of {robot.name}")
    if free[0].parent.name != robot.root_body:
        raise InputError("body of the free joint", where=where, got=free[0].parent.name, expected=robot.root_body)
    if not any(geom.contype or geom.conaffinity for geom in spec.worldbody.geoms):
        raise InputError("no ground", where=where, expected="a colliding geom on the world body, such as a plane")


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
