"""Actors that are one matrix, a device that says what it is told to say, and a clock in its hands."""

import sys
from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper

from core.clock import SimulatedClock
from core.rotations import quat_rotate
from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.settings import load_settings
from hal.contract.types import DeviceInfo, RobotState
from hal.simulated.mujoco import MujocoBackend
from motion.clip import Clip, clip_to_bytes
from policy.metadata import write_metadata
from policy.spec import ActorSpec, ObservationGroup, ObservationTerm, motion_info
from robot.robot import load_robot
from world.scene import FLAT, Scene

ROBOT = load_robot()
SETTINGS = load_settings()
PERIOD_S = 0.02
JOINTS = ROBOT.num_joints
KNEE = ROBOT.joint_names.index("left_knee_joint")
OBSERVATION = ObservationGroup(
    "obs",
    (
        ObservationTerm("base_ang_vel"),
        ObservationTerm("projected_gravity"),
        ObservationTerm("actions"),
        ObservationTerm("ref_motion_phase"),
    ),
)
SIZE = 3 + 3 + JOINTS + 1
COLUMNS = {"base_ang_vel": 0, "projected_gravity": 3}
GRAVITY_X, GRAVITY_Y, GRAVITY_Z = 3, 4, 5
HALF_RATE_S = 0.035
READ: dict[tuple, ActorRun] = {}
PHASE = SIZE - 1
BALANCE = {
    (term, index, f"{side}_ankle_{axis}_joint"): weight
    for side in ("left", "right")
    for term, index, axis, weight in (
        ("projected_gravity", 0, "pitch", 3.0), ("base_ang_vel", 1, "pitch", 0.2),
        ("projected_gravity", 1, "roll", -2.0), ("base_ang_vel", 0, "roll", 0.2),
    )
}  # fmt: skip


def _standing_height_m() -> float:
    """Root height at which the soles of the default pose touch the ground."""
    bodies = ROBOT.kinematics.forward(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), ROBOT.default_pos_rad)
    soles = [
        bodies.pos_w[foot] + quat_rotate(bodies.quat_wxyz[foot], ROBOT.sole_points_m[name])
        for name, foot in zip(ROBOT.feet, ROBOT.tracked_index(ROBOT.feet))
    ]
    return -float(np.concatenate(soles)[:, 2].min())


HEIGHT_M = _standing_height_m()


def still_clip(seconds: float, pose_rad: np.ndarray | None = None, scene: Scene = FLAT) -> Clip:
    frames = round(seconds * 50) + 1
    pose_rad = ROBOT.default_pos_rad if pose_rad is None else pose_rad
    return Clip(
        fps=50.0,
        joint_names=ROBOT.joint_names,
        root_pos_w=np.tile([0.0, 0.0, HEIGHT_M + scene.height_at(np.zeros(2))], (frames, 1)),
        root_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1)),
        joint_pos_rad=np.tile(pose_rad, (frames, 1)),
        contact=np.ones((frames, 2)),
        source="test",
        license="none",
        created_by="test",
        scene=scene,
    )


def write_matrix_actor(path: Path, matrix: np.ndarray, observation: ObservationGroup, **spec) -> ActorSpec:
    """An actor whose action is its observation (1, n) times a matrix (n, J); its file still lacks the spec."""
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weights"], ["action"])],
        "linear",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, len(matrix)])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, JOINTS])],
        [helper.make_tensor("weights", TensorProto.FLOAT, matrix.shape, matrix.ravel())],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), str(path))
    return ActorSpec(
        robot=ROBOT.name,
        joint_names=ROBOT.joint_names,
        default_pos_rad=ROBOT.default_pos_rad,
        kp=ROBOT.kp,
        kd=ROBOT.kd,
        action_scale=np.full(JOINTS, 0.25),
        action_clip=100.0,
        control_period_s=PERIOD_S,
        observations=(observation,),
        **spec,
    )


def write_linear_actor(
    path: Path,
    weights: dict[tuple[int, str], float] | None = None,
    *,
    seconds: float = 1.0,
    pose_rad: np.ndarray | None = None,
    name: str = "toy",
    scene: Scene = FLAT,
) -> Path:
    """target of joint j = its default + sum of weights[i, j] * observation[i]; the clip stands still."""
    matrix = np.zeros((SIZE, JOINTS), dtype=np.float32)
    for (column, joint), weight in (weights or {}).items():
        matrix[column, ROBOT.joint_names.index(joint)] = weight / 0.25
    clip = still_clip(seconds, pose_rad, scene)
    motion = motion_info(clip, name, clip.joint_pos_rad[0])
    spec = write_matrix_actor(path, matrix, OBSERVATION, motion=motion)
    write_metadata(path, spec, clip_to_bytes(clip))
    return path


def write_standing_actor(path: Path, seconds: float = 1.0, name: str = "toy_stand", scene: Scene = FLAT) -> Path:
    """Balances with its ankles: enough to stand in MuJoCo."""
    weights = {(COLUMNS[term] + index, joint): weight for (term, index, joint), weight in BALANCE.items()}
    return write_linear_actor(path, weights, seconds=seconds, name=name, scene=scene)


def linear_run(folder: Path, weights=None, *, seconds: float = 1.0, pose_rad=None, name: str = "toy") -> ActorRun:
    """A run of its own. Of each kind the first one's file is written and read; actor and clip never change."""
    kind = (*(weights or {}).items(), seconds, None if pose_rad is None else pose_rad.tobytes(), name)
    if kind not in READ:
        path = write_linear_actor(folder / f"{name}.onnx", weights, seconds=seconds, pose_rad=pose_rad, name=name)
        READ[kind] = load_run(path, None, ROBOT, SETTINGS.entry)
    return ActorRun(READ[kind].actor, ROBOT, SETTINGS.entry, copy(READ[kind].goals))


@cache
def bundled_run(name: str) -> ActorRun:
    """A bundled actor with its own clip, read once: whoever starts it begins anew."""
    return load_run(name, None, ROBOT, SETTINGS.entry)


def tilted(angle_rad: float) -> np.ndarray:
    """wxyz of a lean forward."""
    return np.array([np.cos(angle_rad / 2), 0.0, np.sin(angle_rad / 2), 0.0])


def state(time_s: float = 0.0, **changes) -> RobotState:
    """Upright, at rest, in the default pose, all values fresh."""
    healthy = RobotState(
        time_s=time_s,
        joint_pos_rad=ROBOT.default_pos_rad.copy(),
        joint_vel_rad_s=np.zeros(JOINTS),
        joint_torque_nm=np.zeros(JOINTS),
        joint_age_s=np.zeros(JOINTS),
        imu_quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        imu_ang_vel_b=np.zeros(3),
        imu_acc_b=np.array([0.0, 0.0, 9.81]),
        imu_age_s=0.0,
        temperature_c=np.full(JOINTS, 35.0),
    )
    return replace(healthy, **changes)


def with_joint(field: str, value: float, joint: int = KNEE, **changes) -> RobotState:
    """The healthy state with one joint's value changed."""
    values = getattr(state(), field).copy()
    values[joint] = value
    return state(**{field: values}, **changes)


class FakeBackend:
    """Plays a script: at reading k the k-th entry (the last one for ever after), raised if it is an error."""

    control_period_s = PERIOD_S

    def __init__(self, script, clock: SimulatedClock, *, read_takes_s=0.0) -> None:
        self.script, self.clock, self.read_takes_s = list(script), clock, read_takes_s
        self.calls: list[str] = []
        self.commands = []
        self.write_times_s: list[float] = []
        self.readings = 0
        self.fail_write = None
        self.released = False

    def open(self) -> DeviceInfo:
        return DeviceInfo("fake", ROBOT.joint_names)

    def read(self) -> RobotState:
        self.clock.sleep_until(self.clock.now_s() + self.read_takes_s)
        entry = self.script[min(self.readings, len(self.script) - 1)]
        self.readings += 1
        if isinstance(entry, Exception):
            raise entry
        return replace(entry, time_s=self.clock.now_s())

    def write(self, command) -> None:
        if self.fail_write is not None:
            raise self.fail_write
        self.calls.append("write")
        self.write_times_s.append(self.clock.now_s())
        self.commands.append(command)

    def damp(self) -> None:
        self.calls.append("damp")

    def acknowledge(self) -> None:
        self.calls.append("acknowledge")

    def close(self) -> None:
        self.calls.append("close")

    @property
    def gantry_attached(self) -> bool:
        return not self.released

    def release_gantry(self) -> None:
        self.released = True


class Asked:
    """A request source with a script: tick number -> requests."""

    def __init__(self, script) -> None:
        self.script, self.tick = script, -1

    def poll(self):
        self.tick += 1
        return self.script.get(self.tick, ())


class LateBackend(MujocoBackend):
    """What was read reaches the loop 35 ms later; the physics goes on meanwhile."""

    late = False

    def read(self):
        reading = super().read()
        if self.late:
            self.clock.sleep_until(self.clock.now_s() + HALF_RATE_S)
        return reading


class SpokenAtOnce:
    """A voice that waits for nobody."""

    def say(self, line: str) -> None:
        print(line)

    def complain(self, line: str) -> None:
        print(line, file=sys.stderr)
