"""The nominal robot as a discrete system: what a control period does to a state, and with what slope."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from core.rotations import quat_conjugate, quat_from_rotvec, quat_mul, quat_to_rotvec
from robot.robot import Robot
from world.model import compile_model
from world.scene import FLAT, Scene

SUBSTEP_S = 0.005
WRENCH_UNIT = np.array([100.0, 100.0, 100.0, 20.0, 20.0, 20.0])  # N and Nm
# Half widths of the finite differences (m and rad, their rates, rad): very wide, so that a contact which begins or
# ends is averaged over. With a third of them the plans of a lifted foot shake until the robot falls.
SMOOTH_POSITION, SMOOTH_VELOCITY, SMOOTH_COMMAND = 0.03, 1.5, 0.1
LINEARIZE_EVERY = 2
DIVERGED = 1e3


@dataclass(frozen=True)
class Motion:
    """qpos (T+1, 7+J), qvel (T+1, 6+J) and commands (T, J+6): joint targets and the wrench on the root, in units."""

    qpos: np.ndarray
    qvel: np.ndarray
    command: np.ndarray

    def __len__(self) -> int:
        return len(self.command)

    def part(self, start: int, end: int) -> "Motion":
        """From the state at tick ``start`` to the state at tick ``end``."""
        return Motion(self.qpos[start : end + 1], self.qvel[start : end + 1], self.command[start:end])

    def deviation(self, wanted: "Motion") -> np.ndarray:
        """(T+1, 2(6+J)) from ``wanted``, in the tangent space."""
        return np.hstack([difference(self.qpos, wanted.qpos), self.qvel - wanted.qvel])

    def diverged(self) -> bool:
        """Whether physics has not held."""
        return not np.abs(self.qvel).max() < DIVERGED

    def helper_force_n(self) -> np.ndarray:
        """(T,) size of the force on the root, per axis."""
        return np.abs(self.command[:, -6:-3] * WRENCH_UNIT[:3]).mean(axis=1)


def joined(parts: Sequence[Motion]) -> Motion:
    """Motions of which each begins in the last state of the one before."""
    first, *rest = parts
    qpos, qvel = [first.qpos, *(p.qpos[1:] for p in rest)], [first.qvel, *(p.qvel[1:] for p in rest)]
    return Motion(np.concatenate(qpos), np.concatenate(qvel), np.concatenate([p.command for p in parts]))


@dataclass(frozen=True)
class Slopes:
    """Of a motion's states (M, 2nv, 2nv) and commands (M, 2nv, J+6), M every second tick, and its gaps (T, 2nv).

    A gap is what a tick of the motion misses its next state by: zero where physics made the motion.
    """

    state: np.ndarray
    command: np.ndarray
    gap: np.ndarray


class PriorPlant:
    """Control periods of the nominal robot, many at a time, with a helping wrench on its root."""

    _CONTROL = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)

    def __init__(self, robot: Robot, substeps: int, threads: int, scene: Scene = FLAT) -> None:
        flags = mujoco.mjtDisableBit

        def compiled() -> mujoco.MjModel:
            return compile_model(robot, timestep_s=SUBSTEP_S, scene=scene, actuation="pd_position", strip_visuals=True)

        self._model = compiled()
        self._model.opt.disableflags |= flags.mjDSBL_AUTORESET
        # Joints that stick, stops and torque limits have no useful slope.
        self._smooth = compiled()
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

    def linearize(self, motion: Motion) -> Slopes:
        """Central differences along a motion, every second tick."""
        nv, rows = self._model.nv, slice(0, len(motion), LINEARIZE_EVERY)
        qpos, qvel, command = motion.qpos[:-1][rows], motion.qvel[:-1][rows], motion.command[rows]
        width = np.concatenate(
            [np.full(nv, SMOOTH_POSITION), np.full(nv, SMOOTH_VELOCITY), np.full(command.shape[1], SMOOTH_COMMAND)]
        )
        moves = np.concatenate([np.diag(width), -np.diag(width)])
        shape = (len(command), len(moves))
        after = self.advance(
            moved(np.broadcast_to(qpos[:, None], (*shape, qpos.shape[1])), moves[:, :nv]).reshape(-1, qpos.shape[1]),
            (qvel[:, None] + moves[:, nv : 2 * nv]).reshape(-1, nv),
            (command[:, None] + moves[:, 2 * nv :]).reshape(-1, command.shape[1]),
            smooth=True,
        )
        (up, down), (up_vel, down_vel) = (np.split(x.reshape(*shape, -1), 2, axis=1) for x in after)
        slope = np.concatenate([difference(up, down), up_vel - down_vel], axis=-1) / (2.0 * width[:, None])
        slope = np.swapaxes(slope, 1, 2)
        next_qpos, next_qvel = self.advance(motion.qpos[:-1], motion.qvel[:-1], motion.command)
        gap = np.hstack([difference(next_qpos, motion.qpos[1:]), next_qvel - motion.qvel[1:]])
        return Slopes(slope[..., : 2 * nv], slope[..., 2 * nv :], gap)


def difference(qpos: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Tangent (..., 6+J) that leads from origin to qpos; rotation in the body frame."""
    turn = quat_to_rotvec(quat_mul(quat_conjugate(origin[..., 3:7]), qpos[..., 3:7]))
    return np.concatenate([qpos[..., :3] - origin[..., :3], turn, qpos[..., 7:] - origin[..., 7:]], axis=-1)


def moved(qpos: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """qpos (..., 7+J) moved along a tangent (..., 6+J)."""
    turned = quat_mul(qpos[..., 3:7], quat_from_rotvec(np.broadcast_to(tangent[..., 3:6], (*qpos.shape[:-1], 3))))
    return np.concatenate([qpos[..., :3] + tangent[..., :3], turned, qpos[..., 7:] + tangent[..., 6:]], axis=-1)
