"""Inverse kinematics of one frame after the other (mink): contacts kept exactly, the rest as near as it goes."""

from collections.abc import Iterator

import mink
import mujoco
import numpy as np

from core.errors import InputError
from motion.author.choreography import Choreography
from motion.author.stand import SIDES, TORSO_BODY, StandPose
from motion.author.targets import AuthoredTargets
from robot.robot import Robot

WAIST_JOINTS = ("waist_yaw_joint", "waist_roll_joint", "waist_pitch_joint")
MAX_ITERATIONS = 60
CONVERGED_RAD = 1e-8
MAX_STEP_RAD = 0.1  # per iteration: further, the linearised problem says little
TOLERANCE = {
    "centre of mass": 0.004,
    "pelvis height": 0.004,
    "hand": 0.015,
    "foot": 0.004,
    "pelvis tilt": 0.03,
    "waist": 0.03,
}


class PointTask(mink.Task):
    """A point of `body` at `offset_m` (3,), in the world or, with `frame_body`, in that body's frame [m]."""

    def __init__(self, body: int, offset_m: np.ndarray, cost: list[float], frame_body: int = 0) -> None:
        super().__init__(cost=np.array(cost))
        self.k = 3
        self.body, self.offset_m, self.frame_body = body, offset_m, frame_body
        self.target_m = np.zeros(3)

    def compute_error(self, configuration: mink.Configuration) -> np.ndarray:
        """Position minus target (3,)."""
        data = configuration.data
        return self._frame(data).T @ (self._point_w(data) - data.xpos[self.frame_body]) - self.target_m

    def compute_jacobian(self, configuration: mink.Configuration) -> np.ndarray:
        """Derivative of the error (3, nv)."""
        model, data = configuration.model, configuration.data
        point, moving, carried = self._point_w(data), np.empty((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, moving, None, point, self.body)
        if self.frame_body:
            mujoco.mj_jac(model, data, carried, None, point, self.frame_body)
        return self._frame(data).T @ (moving - carried)

    def _point_w(self, data: mujoco.MjData) -> np.ndarray:
        return data.xpos[self.body] + data.xmat[self.body].reshape(3, 3) @ self.offset_m

    def _frame(self, data: mujoco.MjData) -> np.ndarray:
        return data.xmat[self.frame_body].reshape(3, 3)


class AuthoringSolver:
    """Solves frames in order, each from the one before."""

    def __init__(self, robot: Robot, stand: StandPose) -> None:
        self.model = stand.model
        self.configuration = mink.Configuration(self.model, q=stand.qpos)
        body = {name: self.model.body(name).id for name in (*robot.body_names,)}
        self.feet = [mink.FrameTask(foot, "body", 40.0, [0.5, 3.0, 3.0]) for foot in robot.feet]
        self.com = mink.ComTask([20.0, 20.0, 0.0])
        self.height = PointTask(body[robot.root_body], np.zeros(3), [0.0, 0.0, 20.0])
        self.pelvis = mink.FrameTask(robot.root_body, "body", 0.0, 5.0)
        self.waist = self.model.jnt_qposadr[[self.model.joint(name).id for name in WAIST_JOINTS]]
        posture = np.full(self.model.nv, 0.003)
        posture[self.waist - 1] = 5.0
        self.posture, self.posture_qpos = mink.PostureTask(self.model, posture), stand.qpos.copy()
        torso, arms = body[TORSO_BODY], [stand.arms[side] for side in SIDES]
        self.hands = [PointTask(body[a.elbow_body], a.hand_offset_m, [4.0] * 3, torso) for a in arms]
        self.elbows = [PointTask(body[a.elbow_body], np.zeros(3), [1.0] * 3, torso) for a in arms]
        self.limits = [mink.ConfigurationLimit(self.model, gain=1.0)]

    def solve(self, targets: AuthoredTargets, frame: int) -> np.ndarray:
        """qpos (7+J,) of one frame. Raises mink.NoSolutionFound when the feet cannot be where they should."""
        for i in range(2):
            self.feet[i].set_target(_pose(targets.foot_quat_wxyz[frame, i], targets.foot_pos_w[frame, i]))
            self.hands[i].target_m, self.elbows[i].target_m = targets.hand_m[frame, i], targets.elbow_m[frame, i]
        self.com.set_target(np.append(targets.com_w[frame], 0.0))
        self.height.target_m = np.array([0.0, 0.0, targets.pelvis_height_m[frame]])
        self.pelvis.set_target(_pose(targets.pelvis_quat_wxyz[frame], np.zeros(3)))
        self.posture_qpos[self.waist] = targets.waist_rad[frame]
        self.posture.set_target(self.posture_qpos)
        swinging = [foot for foot, down in zip(self.feet, targets.contact[frame], strict=True) if not down]
        standing = [foot for foot in self.feet if foot not in swinging]
        tasks = [self.com, self.height, self.pelvis, self.posture, *self.hands, *self.elbows, *swinging]
        for _ in range(MAX_ITERATIONS):
            step = mink.solve_ik(
                self.configuration, tasks, 1.0, "daqp", damping=1e-6, limits=self.limits, constraints=standing
            )
            longest = np.abs(step).max()
            self.configuration.integrate_inplace(step * min(1.0, MAX_STEP_RAD / max(longest, MAX_STEP_RAD)), 1.0)
            if longest < CONVERGED_RAD:
                break
        return self.configuration.q

    def misses(self, targets: AuthoredTargets, frame: int) -> Iterator[tuple[str, float]]:
        """(what, how far off) of the frame just solved; metres or radians."""
        yield "centre of mass", _norm(self.com.compute_error(self.configuration)[:2])
        yield "pelvis height", abs(self.height.compute_error(self.configuration)[2])
        yield "pelvis tilt", _norm(self.pelvis.compute_error(self.configuration)[3:])
        yield "waist", np.abs(self.configuration.q[self.waist] - targets.waist_rad[frame]).max()
        for side, hand, foot in zip(SIDES, self.hands, self.feet, strict=True):
            yield f"{side} hand", _norm(hand.compute_error(self.configuration))
            yield f"{side} foot", _norm(foot.compute_error(self.configuration)[:3])


def solve_frames(robot: Robot, stand: StandPose, choreography: Choreography, targets: AuthoredTargets) -> np.ndarray:
    """qpos (N,7+J) of every frame. Raises InputError naming the key whose target cannot be reached."""
    solver = AuthoringSolver(robot, stand)
    frames = np.empty((len(targets.times_s), len(stand.qpos)))
    for frame, time in enumerate(targets.times_s):
        where = choreography.where(choreography.key_at(time))
        try:
            frames[frame] = solver.solve(targets, frame)
        except (mink.NoSolutionFound, mink.NotWithinConfigurationLimits) as error:
            raise InputError(f"the feet cannot be reached at {time:.2f} s", where=where) from error
        for what, miss in solver.misses(targets, frame):
            allowed = TOLERANCE[what.removeprefix("left ").removeprefix("right ")]
            if miss > allowed:
                got = f"{miss:.3f} off at {time:.2f} s"
                raise InputError(f"{what}: unreachable target", where=where, got=got, expected=f"within {allowed}")
    return frames


def _pose(quat_wxyz: np.ndarray, position: np.ndarray) -> mink.SE3:
    return mink.SE3.from_rotation_and_translation(mink.SO3(quat_wxyz), position)


def _norm(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))
