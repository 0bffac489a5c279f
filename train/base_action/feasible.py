"""A motion near the reference that the simulated robot can make: iLQR with a helper force that fades away.

A retargeted motion asks for what no robot can do: its feet sink, float and slide, its centre of mass leaves the soles.
Whoever tracks it must find the nearest motion that physics allows; finding that one by optimisation takes a minute,
finding it by reinforcement learning takes an hour. The physics is that of training: nominal model, contacts, torque
limits, joint friction. A wrench on the root makes the reference itself possible at first; its price then rises, from
iteration to iteration, until the joints do everything.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from mujoco.rollout import Rollout
from scipy.ndimage import gaussian_filter1d

from motion.reference import Reference
from robot.mjcf import compile_model
from robot.robot import Robot
from robot.rotations import quat_conjugate, quat_from_rotvec, quat_mul, quat_rotate, quat_to_rotvec
from train.base_action.feedforward import generalized_motion

SUBSTEP_S = 0.005
WRENCH_UNIT = np.array([100.0, 100.0, 100.0, 20.0, 20.0, 20.0])  # N and Nm
# Price of a squared unit of wrench, one entry an iteration.
WRENCH_COSTS = np.concatenate([[1e-3, 1e-3], np.geomspace(1e-3, 1e3, 12), [1e3, 1e3, 1e3]])
TARGET_COST = 10.0
STEP_SIZES = np.array([1.0, 0.7, 0.5, 0.3, 0.15, 0.07])
# Half widths of the finite differences: wide, so that a contact which begins or ends is averaged over.
SMOOTH_POSITION, SMOOTH_VELOCITY, SMOOTH_COMMAND = 1e-2, 0.4, 0.02
LINEARIZE_EVERY = 3
FEEDBACK_MAX = 3.0
LIFT_SMOOTHING_TICKS = 3.0
DIVERGED = 1e3
# A motion that still leans on the wrench is no better an aim than the reference; nor will it be after this many
# iterations without progress.
HELPER_FORCE_MAX_N = 5.0
REJECTED_MAX = 4


@dataclass(frozen=True)
class Nominal:
    """What the base action aims at: a motion of root and joints (K+1 ticks), and the joint targets that make it.

    ``reference``: its body poses are those of the original. ``targets_rad`` (K+1, J): the last one is repeated.
    """

    reference: Reference
    targets_rad: np.ndarray

    @classmethod
    def of(cls, reference: Reference, qpos: np.ndarray, qvel: np.ndarray, targets_rad: np.ndarray) -> "Nominal":
        """From MuJoCo coordinates (K+1, 7+J), (K+1, 6+J) and targets (K, J) or (K+1, J)."""
        moved = replace(
            reference,
            root_pos_w=qpos[:, :3],
            root_quat_wxyz=qpos[:, 3:7],
            joint_pos_rad=qpos[:, 7:],
            root_lin_vel_w=qvel[:, :3],
            root_ang_vel_w=quat_rotate(qpos[:, 3:7], qvel[:, 3:6]),
            joint_vel_rad_s=qvel[:, 6:],
        )
        return cls(moved, np.vstack([targets_rad, targets_rad[-1:]])[: len(qpos)])

    def save(self, path: Path) -> None:
        """Write it as .npz."""
        qpos, qvel, _ = generalized_motion(self.reference)
        with path.open("wb") as file:
            np.savez(file, qpos=qpos, qvel=qvel, targets_rad=self.targets_rad)

    @classmethod
    def load(cls, path: Path, reference: Reference) -> "Nominal":
        """Read what :meth:`save` wrote for this reference."""
        with np.load(path) as stored:
            return cls.of(reference, stored["qpos"], stored["qvel"], stored["targets_rad"])


def feasible_motion(
    robot: Robot, wanted: Nominal, lift_m: np.ndarray, *, threads: int, progress: Callable[[str], None]
) -> Nominal:
    """Find the nearest motion to ``wanted`` that the nominal robot makes by itself. Takes a minute or two.

    Motions with flight or quick turns on one foot are beyond this method: it then returns ``wanted`` and says so.

    Args:
        robot: its nominal model is used.
        wanted: the motion and joint targets to start from.
        lift_m: (K+1,) height correction that puts the motion on the ground.
        threads: worker threads.
        progress: told one line an iteration.
    """
    qpos, qvel, _ = generalized_motion(wanted.reference)
    qpos[:, 2] += gaussian_filter1d(lift_m, LIFT_SMOOTHING_TICKS)
    physics = _Physics(robot, round(wanted.reference.dt_s / SUBSTEP_S), threads)
    no_wrench = np.zeros((len(qpos) - 1, len(WRENCH_UNIT)))
    found = _optimize(physics, _Motion(qpos, qvel, np.hstack([wanted.targets_rad[:-1], no_wrench])), progress)
    if found.helper_force_n() > HELPER_FORCE_MAX_N:
        progress("feasible motion: none found; the base action aims at the reference")
        return wanted
    return Nominal.of(wanted.reference, found.qpos, found.qvel, found.command[:, :-6])


@dataclass(frozen=True)
class _Motion:
    """qpos (T, 7+J), qvel (T, 6+J) and commands (T-1, J+6): joint targets and the wrench on the root, in units."""

    qpos: np.ndarray
    qvel: np.ndarray
    command: np.ndarray

    def deviation(self, wanted: "_Motion") -> np.ndarray:
        """(T, 2(6+J)) from ``wanted``, in the tangent space."""
        return np.hstack([_difference(self.qpos, wanted.qpos), self.qvel - wanted.qvel])

    def helper_force_n(self) -> float:
        """Mean size of the force on the root, per axis."""
        return float(np.abs(self.command[:, -6:-3] * WRENCH_UNIT[:3]).mean())


def _optimize(physics: "_Physics", wanted: _Motion, progress: Callable[[str], None]) -> _Motion:
    """Iterate over the prices; a step that costs more than it had is not taken."""
    motion, rejected = wanted, 0
    state_cost = _state_cost(wanted.qvel.shape[1])
    command_cost = np.full(wanted.command.shape[1], TARGET_COST)
    least = np.inf  # the reference itself is no motion of the robot: whatever is played first is taken
    for iteration, wrench_cost in enumerate(WRENCH_COSTS):
        command_cost[-6:] = wrench_cost
        a, b, gap = physics.linearize(motion)
        feedback, correction = _backward(a, b, gap, motion, wanted, state_cost, command_cost)
        tried = physics.play(motion, feedback, correction)
        costs = [_cost(m, wanted, state_cost, command_cost) for m in tried]
        chosen = int(np.argmin(costs))
        if iteration:
            least = _cost(motion, wanted, state_cost, command_cost)
        rejected = 0 if costs[chosen] < least else rejected + 1
        if not rejected:
            motion = tried[chosen]
        away_mm = 1e3 * np.linalg.norm(motion.qpos[:, :3] - wanted.qpos[:, :3], axis=1).mean()
        progress(
            f"feasible motion {iteration + 1}/{len(WRENCH_COSTS)}: "
            f"root {away_mm:.0f} mm from the reference, helper force {motion.helper_force_n():.1f} N"
        )
        if rejected == REJECTED_MAX:
            break
    return motion


def _cost(motion: _Motion, wanted: _Motion, state_cost: np.ndarray, command_cost: np.ndarray) -> float:
    """Half the weighted sum of squared deviations; infinite where physics has diverged."""
    if not np.abs(motion.qvel).max() < DIVERGED:
        return np.inf
    states = (motion.deviation(wanted) ** 2 * state_cost).sum()
    return 0.5 * float(states + ((motion.command - wanted.command) ** 2 * command_cost).sum())


def _state_cost(nv: int) -> np.ndarray:
    """Weights (2nv,) of squared deviations: root position (m) and rotation (rad), joints, and their velocities."""
    position, velocity = np.full(nv, 4.0), np.full(nv, 0.02)
    position[:3], position[3:6] = 100.0, 50.0
    velocity[:3], velocity[3:6] = 2.0, 0.5
    return np.concatenate([position, velocity])


def _backward(
    a: np.ndarray,
    b: np.ndarray,
    gap: np.ndarray,
    motion: _Motion,
    wanted: _Motion,
    state_cost: np.ndarray,
    command_cost: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Riccati recursion: feedback (T-1, J+6, 2nv) and correction (T-1, J+6) of the commands."""
    deviation, excess = motion.deviation(wanted), command_cost * (motion.command - wanted.command)
    curvature, slope = np.diag(state_cost), state_cost * deviation[-1]
    feedback, correction = np.empty((*excess.shape, len(state_cost))), np.empty_like(excess)
    for tick in range(len(excess) - 1, -1, -1):
        step_a, step_b = a[tick // LINEARIZE_EVERY], b[tick // LINEARIZE_EVERY]
        slope = slope + curvature @ gap[tick]
        ahead = curvature @ step_a
        mixed = step_b.T @ ahead
        solved = np.linalg.solve(
            np.diag(command_cost) + step_b.T @ curvature @ step_b,
            np.column_stack([mixed, excess[tick] + step_b.T @ slope]),
        )
        feedback[tick], correction[tick] = solved[:, :-1], solved[:, -1]
        slope = state_cost * deviation[tick] + step_a.T @ slope - mixed.T @ correction[tick]
        curvature = np.diag(state_cost) + step_a.T @ ahead - mixed.T @ feedback[tick]
        curvature = 0.5 * (curvature + curvature.T)
    return feedback, correction


class _Physics:
    """Control periods of the nominal robot, many at a time."""

    _CONTROL = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)

    def __init__(self, robot: Robot, substeps: int, threads: int) -> None:
        flags = mujoco.mjtDisableBit
        self._model = compile_model(robot, timestep_s=SUBSTEP_S, actuation="position", strip_visuals=True)
        self._model.opt.disableflags |= flags.mjDSBL_AUTORESET
        # Joints that stick, stops and torque limits have no useful slope.
        self._smooth = compile_model(robot, timestep_s=SUBSTEP_S, actuation="position", strip_visuals=True)
        self._smooth.opt.disableflags |= flags.mjDSBL_AUTORESET | flags.mjDSBL_FRICTIONLOSS | flags.mjDSBL_LIMIT
        self._smooth.actuator_forcelimited[:] = 0
        self._substeps = substeps
        self._rollout = Rollout(nthread=threads)
        self._data = [mujoco.MjData(self._model) for _ in range(threads)]

    def advance(
        self, qpos: np.ndarray, qvel: np.ndarray, command: np.ndarray, *, smooth: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """One control period from states (n, 7+J), (n, 6+J) with commands (n, J+6)."""
        model, joints = self._model, self._model.nu
        state = np.hstack([np.zeros((len(qpos), 1)), qpos, qvel])
        control = np.hstack([command[:, :joints], command[:, joints:] * WRENCH_UNIT, np.zeros((len(qpos), joints))])
        control = np.repeat(control[:, None], self._substeps, axis=1)
        chosen = self._smooth if smooth else model
        states, _ = self._rollout.rollout(
            [chosen], self._data, state, control, control_spec=self._CONTROL, nstep=self._substeps
        )
        last = np.nan_to_num(states[:, -1], nan=DIVERGED, posinf=DIVERGED, neginf=-DIVERGED)
        return last[:, 1 : 1 + model.nq], last[:, 1 + model.nq : 1 + model.nq + model.nv]

    def linearize(self, motion: _Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Slopes (M, 2nv, 2nv) and (M, 2nv, J+6) at every third tick, and what each tick misses its next by."""
        nv, rows = self._model.nv, slice(0, len(motion.command), LINEARIZE_EVERY)
        qpos, qvel, command = motion.qpos[:-1][rows], motion.qvel[:-1][rows], motion.command[rows]
        width = np.concatenate(
            [np.full(nv, SMOOTH_POSITION), np.full(nv, SMOOTH_VELOCITY), np.full(command.shape[1], SMOOTH_COMMAND)]
        )
        moves = np.concatenate([np.diag(width), -np.diag(width)])
        shape = (len(command), len(moves))
        after = self.advance(
            _moved(np.broadcast_to(qpos[:, None], (*shape, qpos.shape[1])), moves[:, :nv]).reshape(-1, qpos.shape[1]),
            (qvel[:, None] + moves[:, nv : 2 * nv]).reshape(-1, nv),
            (command[:, None] + moves[:, 2 * nv :]).reshape(-1, command.shape[1]),
            smooth=True,
        )
        (up, down), (up_vel, down_vel) = (np.split(x.reshape(*shape, -1), 2, axis=1) for x in after)
        slope = np.concatenate([_difference(up, down), up_vel - down_vel], axis=-1) / (2.0 * width[:, None])
        slope = np.swapaxes(slope, 1, 2)
        next_qpos, next_qvel = self.advance(motion.qpos[:-1], motion.qvel[:-1], motion.command)
        gap = np.hstack([_difference(next_qpos, motion.qpos[1:]), next_qvel - motion.qvel[1:]])
        return slope[..., : 2 * nv], slope[..., 2 * nv :], gap

    def play(self, motion: _Motion, feedback: np.ndarray, correction: np.ndarray) -> list[_Motion]:
        """Play the corrected commands under feedback from the first state, once per step size."""
        count = len(STEP_SIZES)
        qpos, qvel, commands = [np.repeat(motion.qpos[:1], count, 0)], [np.repeat(motion.qvel[:1], count, 0)], []
        for tick, command in enumerate(motion.command):
            deviation = np.hstack([_difference(qpos[-1], motion.qpos[tick]), qvel[-1] - motion.qvel[tick]])
            back = np.clip(deviation @ feedback[tick].T, -FEEDBACK_MAX, FEEDBACK_MAX)
            commands.append(command - STEP_SIZES[:, None] * correction[tick] - back)
            after = self.advance(qpos[-1], qvel[-1], commands[-1])
            qpos.append(after[0])
            qvel.append(after[1])
        stacked = [np.stack(values, axis=1) for values in (qpos, qvel, commands)]
        return [_Motion(*(values[i] for values in stacked)) for i in range(count)]


def _difference(qpos: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Tangent (..., 6+J) that leads from origin to qpos; rotation in the body frame."""
    turn = quat_to_rotvec(quat_mul(quat_conjugate(origin[..., 3:7]), qpos[..., 3:7]))
    return np.concatenate([qpos[..., :3] - origin[..., :3], turn, qpos[..., 7:] - origin[..., 7:]], axis=-1)


def _moved(qpos: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """qpos (..., 7+J) moved along a tangent (..., 6+J)."""
    turned = quat_mul(qpos[..., 3:7], quat_from_rotvec(np.broadcast_to(tangent[..., 3:6], (*qpos.shape[:-1], 3))))
    return np.concatenate([qpos[..., :3] + tangent[..., :3], turned, qpos[..., 7:] + tangent[..., 6:]], axis=-1)
