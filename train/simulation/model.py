"""The nominal model that training steps: a robot in a scene, with sensors of its torques and contacts."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

from core.structured import at_least, positive
from robot.robot import Robot
from world.model import add_contact_sensors, compile_model
from world.scene import Scene


@dataclass(frozen=True)
class SimulationSettings:
    """Physics steps per control step, and what differs from the robot's description; None: nothing.

    ``ankle_inertia_kg_m2``: each principal inertia of the ankle links. ``armature_kg_m2``, ``joint_friction_nm``: of
    every joint; without any friction physics is a third faster.
    """

    substeps: int = 4
    ankle_inertia_kg_m2: float | None = None
    armature_kg_m2: float | None = None
    joint_friction_nm: float | None = None

    def __post_init__(self) -> None:
        where = "environment.simulation"
        at_least(f"{where}.substeps", self.substeps, 1)
        if self.ankle_inertia_kg_m2 is not None:
            positive(f"{where}.ankle_inertia_kg_m2", self.ankle_inertia_kg_m2)
        for name in ("armature_kg_m2", "joint_friction_nm"):
            if getattr(self, name) is not None:
                at_least(f"{where}.{name}", getattr(self, name), 0.0)


def training_model(
    robot: Robot, settings: SimulationSettings, *, scene: Scene, timestep_s: float, sensed: Sequence[str]
) -> mujoco.MjModel:
    """The nominal robot in a scene. Its last sensors are the motors' torques and the contact forces of ``sensed``."""

    def edit(spec: mujoco.MjSpec) -> None:
        _add_torque_sensors(spec)
        add_contact_sensors(spec, sensed)

    model = compile_model(
        robot, timestep_s=timestep_s, scene=scene, actuation="pd_position", strip_visuals=True, edit=edit
    )
    # A reset by MuJoCo itself would hide that physics has diverged. Each rollout starts the solver cold anyway: a warm
    # start of its few sub-steps costs more than it saves.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_WARMSTART
    # Joint friction concerns one joint, a contact one leg: a sparse Jacobian is a tenth faster.
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    joints = slice(model.nv - robot.num_joints, None)
    if settings.ankle_inertia_kg_m2 is not None:
        model.body_inertia[[model.body(name).id for name in robot.ankle_bodies]] = settings.ankle_inertia_kg_m2
    if settings.armature_kg_m2 is not None:
        model.dof_armature[joints] = settings.armature_kg_m2
    if settings.joint_friction_nm is not None:
        model.dof_frictionloss[joints] = settings.joint_friction_nm
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _add_torque_sensors(spec: mujoco.MjSpec) -> None:
    for actuator in spec.actuators:
        spec.add_sensor(
            name=f"torque_{actuator.name}",
            type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
            objtype=mujoco.mjtObj.mjOBJ_ACTUATOR,
            objname=actuator.name,
        )
