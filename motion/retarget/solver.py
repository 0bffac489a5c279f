"""Differential inverse kinematics, frame after frame: one small quadratic program per step (daqp).

Each step minimises the weighted squares of all errors, linearised, within hard bounds: joint ranges, and joint speeds
counted from the frame before. Distances between bodies and to the floor are kept by soft constraints of a very high
weight, so that there always is a solution. Steps that make things worse are taken back and damped more
(Levenberg-Marquardt): where a leg is stretched, undamped steps jump to and fro.
"""

from dataclasses import dataclass

import daqp
import numpy as np

from core.rotations import quat_conjugate, quat_mul, quat_to_rotvec
from motion.retarget.body import ROOT_DOFS, Body
from motion.retarget.settings import SolverSettings
from robot.kinematics import TrackedPoint
from robot.robot import Robot

SOFT = 8  # daqp: may be violated if necessary
DEPTH_WEIGHT = 1e4  # of the squared violation of a distance [m], when two poses are compared
UNBOUNDED = 1e30
MAX_ROOT_STEP_M = 1.0
WITHIN = 1.0 - 1e-9  # share of the speed limit, so that rounding does not exceed it
DAMPING_FACTOR = 4.0


@dataclass(frozen=True)
class TargetLayout:
    """What the targets are about: R turning bodies, V lines from point to point, P points."""

    rotations: tuple[str, ...]
    lines: tuple[tuple[TrackedPoint, TrackedPoint], ...]
    points: tuple[TrackedPoint, ...]


@dataclass(frozen=True, eq=False)
class Targets:
    """N frames: rotation_wxyz (N,R,4), line_w (N,V,3) m, point_w (N,P,3) m, joint_pos_rad (N,J).

    Weights (N,R), (V,), (N,P), (J,) are per radian and per metre.
    """

    rotation_wxyz: np.ndarray
    rotation_weight: np.ndarray
    line_w: np.ndarray
    line_weight: np.ndarray
    point_w: np.ndarray
    point_weight: np.ndarray
    joint_pos_rad: np.ndarray
    joint_weight: np.ndarray


@dataclass(frozen=True, eq=False)
class _Problem:
    """The quadratic program around qpos: cost there, and how cost and distances change; apart >= room is wanted."""

    qpos: np.ndarray
    cost: float
    hessian: np.ndarray
    gradient: np.ndarray
    apart: np.ndarray
    room: np.ndarray


class FrameSolver:
    """Solves frames in order, each from the one before.

    The joints in `given` (J,) follow their targets as their limits allow, whatever the rest wants or touches.
    """

    def __init__(
        self, robot: Robot, layout: TargetLayout, settings: SolverSettings, fps: float, given: np.ndarray
    ) -> None:
        self._body, self._settings, self._given = Body(robot, settings.look_ahead_m, given), settings, given
        self._lower, self._upper = robot.pos_lower_rad, robot.pos_upper_rad
        self._reach = robot.vel_limit_rad_s / fps * WITHIN
        self._slowness = (settings.speed_weight * fps) ** 2
        body = {name: self._body.model.body(name).id for name in robot.body_names}
        self._rotations = np.array([body[name] for name in layout.rotations])
        points = [point for line in layout.lines for point in line] + list(layout.points)
        self._points = np.array([body[point.parent] for point in points])
        self._offsets_m = np.array([point.offset_m for point in points])
        self._combine = _combination(len(layout.lines), len(layout.points))
        self._step_limit = np.full(self._body.nv, settings.max_step_rad)
        self._step_limit[:3] = MAX_ROOT_STEP_M

    def solve(self, targets: Targets, start_qpos: np.ndarray) -> np.ndarray:
        """qpos (N,7+J) of all frames; the first is sought from `start_qpos` (7+J,)."""
        frames = np.empty((len(targets.joint_pos_rad), len(start_qpos)))
        qpos, before = start_qpos, None
        for frame in range(len(frames)):
            lower, upper = self._lower, self._upper
            if before is not None:
                lower, upper = np.maximum(lower, before[7:] - self._reach), np.minimum(upper, before[7:] + self._reach)
            follow = np.clip(targets.joint_pos_rad[frame], lower, upper)
            lower, upper = np.where(self._given, follow, lower), np.where(self._given, follow, upper)
            count = self._settings.first_iterations if before is None else self._settings.iterations
            qpos = self._solve_frame(targets, frame, qpos, before, (lower, upper), count)
            frames[frame] = before = qpos
        return frames

    def _solve_frame(
        self,
        targets: Targets,
        frame: int,
        start_qpos: np.ndarray,
        before: np.ndarray | None,
        bounds: tuple[np.ndarray, np.ndarray],
        iterations: int,
    ) -> np.ndarray:
        """qpos (7+J,) of one frame from a start near it; `before` is the frame before."""
        damping = self._settings.damping
        problem = self._problem(targets, frame, _within(start_qpos, bounds), before)
        for _ in range(iterations):
            step = self._step(problem, bounds, damping)
            if step is None:
                damping *= DAMPING_FACTOR
                continue
            tried = self._problem(targets, frame, _within(self._body.moved(problem.qpos, step), bounds), before)
            small = np.abs(step).max() < self._settings.converged_rad
            if tried.cost <= problem.cost:
                problem, damping = tried, max(damping / DAMPING_FACTOR, self._settings.damping)
            else:
                damping *= DAMPING_FACTOR
            if small:
                break
        return problem.qpos

    def _problem(self, targets: Targets, frame: int, qpos: np.ndarray, before: np.ndarray | None) -> _Problem:
        """All errors at `qpos`, squared and weighted, and their change."""
        self._body.pose(qpos)
        rows, errors = self._errors(targets, frame)
        hessian, gradient, cost = rows.T @ rows, errors @ rows, errors @ errors
        diagonal = np.zeros(self._body.nv)
        weight, missed = targets.joint_weight**2, qpos[7:] - targets.joint_pos_rad[frame]
        diagonal[ROOT_DOFS:] += weight
        gradient[ROOT_DOFS:] += weight * missed
        cost += weight @ missed**2
        if before is not None:
            way = self._body.way(before, qpos)
            diagonal += self._slowness
            gradient += self._slowness * way
            cost += self._slowness * (way @ way)
        hessian[np.diag_indices(self._body.nv)] += diagonal
        distance, apart, floor = self._body.distances()
        room = np.where(floor, 0.0, self._settings.clearance_m) - distance
        cost += DEPTH_WEIGHT * (np.maximum(room, 0.0) ** 2).sum()
        return _Problem(qpos, float(cost), hessian, gradient, apart, room)

    def _step(self, problem: _Problem, bounds: tuple[np.ndarray, np.ndarray], damping: float) -> np.ndarray | None:
        """The step (nv,) that solves the damped program within the bounds of the joints; None when daqp gives up."""
        joints, nv = problem.qpos[7:], self._body.nv
        least, most = -self._step_limit, self._step_limit.copy()
        least[ROOT_DOFS:] = np.maximum(least[ROOT_DOFS:], bounds[0] - joints)
        most[ROOT_DOFS:] = np.minimum(most[ROOT_DOFS:], bounds[1] - joints)
        above = np.concatenate((most, np.full(len(problem.room), UNBOUNDED)))
        sense = np.zeros(len(above), dtype=np.int32)
        sense[nv:] = SOFT
        hessian = problem.hessian + damping**2 * np.eye(nv)
        step, _, flag, _ = daqp.solve(
            hessian, problem.gradient, problem.apart, above, np.concatenate((least, problem.room)), sense
        )
        return np.asarray(step) if flag > 0 else None

    def _errors(self, targets: Targets, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Weighted Jacobian (M,nv) and error (M,) of rotations, lines and points."""
        body, weight = self._body, targets.rotation_weight[frame][:, None]
        turned = quat_mul(body.data.xquat[self._rotations], quat_conjugate(targets.rotation_wxyz[frame]))
        turns = body.turn_jacobians(self._rotations) * weight[:, None]
        points_w = body.points_w(self._points, self._offsets_m)
        combine = np.concatenate((targets.line_weight, targets.point_weight[frame]))[:, None] * self._combine
        wanted = np.concatenate((targets.line_weight[:, None] * targets.line_w[frame],
                                 targets.point_weight[frame][:, None] * targets.point_w[frame]))  # fmt: skip
        moves = combine @ body.point_jacobians(points_w, self._points).reshape(len(points_w), -1)
        rows = np.concatenate((turns.reshape(-1, body.nv), moves.reshape(-1, body.nv)))
        return rows, np.concatenate(((weight * quat_to_rotvec(turned)).ravel(), (combine @ points_w - wanted).ravel()))


def _within(qpos: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return np.concatenate((qpos[:7], np.clip(qpos[7:], *bounds)))


def _combination(num_lines: int, num_points: int) -> np.ndarray:
    """(V+P, 2V+P): from the ends of the lines and the points to the lines and the points."""
    combine = np.zeros((num_lines + num_points, 2 * num_lines + num_points))
    lines, points = np.arange(num_lines), np.arange(num_points)
    combine[lines, 2 * lines], combine[lines, 2 * lines + 1] = -1.0, 1.0
    combine[num_lines + points, 2 * num_lines + points] = 1.0
    return combine
