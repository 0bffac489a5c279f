"""What an actor is to follow: the clip at every control tick, with the robot's bodies from forward kinematics."""

from dataclasses import dataclass

import numpy as np

from core.config import errors_in
from core.errors import InputError
from motion.clip import Clip
from motion.resample import sample_clip
from robot.robot import Robot
from world.scene import FLAT, Scene

MAX_DURATION_S = 3600.0


@dataclass(frozen=True)
class Reference:
    """Row k of each table is the motion at k*dt_s, k = 0..K with K = floor(duration/dt); float64, read-only.

    Joints in the robot's order; bodies = the robot's tracked names. Positions m, velocities m/s and rad/s, world frame.
    joint_* (K+1,J); root_* (K+1,3 or 4); body_* (K+1,27,3 or 4); contact (K+1,2); phase (K+1,) = min(1, k*dt/duration).
    scene: what the clip stands in. feedforward_rad (K+1,J): see :mod:`motion.feedforward`; steering (K+1,4): see
    :mod:`motion.steering`; None where nobody asked.
    """

    dt_s: float
    duration_s: float
    joint_pos_rad: np.ndarray
    joint_vel_rad_s: np.ndarray
    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    root_lin_vel_w: np.ndarray
    root_ang_vel_w: np.ndarray
    body_pos_w: np.ndarray
    body_quat_wxyz: np.ndarray
    body_lin_vel_w: np.ndarray
    body_ang_vel_w: np.ndarray
    contact: np.ndarray
    phase: np.ndarray
    scene: Scene = FLAT
    feedforward_rad: np.ndarray | None = None
    steering: np.ndarray | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def num_ticks(self) -> int:
        """K: the control ticks that the clip lasts."""
        return len(self.phase) - 1

    @property
    def floor_m(self) -> float:
        """Height of the scene's floor."""
        return self.scene.floor_m


def build_reference(clip: Clip, robot: Robot, dt_s: float = 0.02) -> Reference:
    """Tables of `clip` for `robot` at every control tick; joints are matched by name.

    Raises InputError when the clip's joints are not the robot's, or it is shorter than a tick or longer than an hour.
    """
    if not dt_s > 0.0:
        raise InputError("bad control period", got=dt_s, expected="a positive number of seconds")
    ticks = int(np.floor(clip.duration_s / dt_s + 1e-9))
    if ticks < 1 or clip.duration_s > MAX_DURATION_S:
        expected = f"from one control period ({dt_s:g} s) to {MAX_DURATION_S:g} s"
        raise InputError("bad length", got=f"{clip.duration_s:g} s", expected=expected)
    times_s = np.arange(ticks + 1) * dt_s
    samples = sample_clip(clip, times_s)
    columns = joint_columns(clip, robot)
    joint_pos, joint_vel = samples.joint_pos_rad[:, columns], samples.joint_vel_rad_s[:, columns]
    root_pose, root_vel = (samples.root_pos_w, samples.root_quat_wxyz), (samples.root_lin_vel_w, samples.root_ang_vel_w)
    bodies = robot.kinematics.forward(*root_pose, joint_pos, *root_vel, joint_vel)
    assert bodies.lin_vel_w is not None and bodies.ang_vel_w is not None
    return Reference(
        dt_s=dt_s,
        duration_s=clip.duration_s,
        joint_pos_rad=joint_pos,
        joint_vel_rad_s=joint_vel,
        root_pos_w=samples.root_pos_w,
        root_quat_wxyz=samples.root_quat_wxyz,
        root_lin_vel_w=samples.root_lin_vel_w,
        root_ang_vel_w=samples.root_ang_vel_w,
        body_pos_w=bodies.pos_w,
        body_quat_wxyz=bodies.quat_wxyz,
        body_lin_vel_w=bodies.lin_vel_w,
        body_ang_vel_w=bodies.ang_vel_w,
        contact=samples.contact,
        phase=np.minimum(1.0, times_s / clip.duration_s),
        scene=clip.scene,
    )


def joint_columns(clip: Clip, robot: Robot, where: str | None = None) -> np.ndarray:
    """Columns (J,) of the clip's joints in the robot's order. Raises InputError naming the joints that do not match."""
    with errors_in(where):
        return robot.joint_index(clip.joint_names)
