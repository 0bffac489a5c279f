"""A motion near the reference that the simulated robot can make: iLQR with a helper force that fades away.

A retargeted motion asks for what no robot can do: its feet sink, float and slide, its centre of mass leaves the soles.
Whoever tracks it must find the nearest motion that physics allows; finding that one by optimisation takes minutes,
finding it by reinforcement learning takes an hour. The physics is that of the nominal robot: contacts, torque limits,
joint friction. A wrench on the root makes the reference itself possible at first; its price then rises, from pass to
pass, until the joints do everything.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from core.rotations import quat_rotate
from motion.inverse_dynamics import generalized_motion
from motion.reference import Reference
from robot.robot import Robot
from train.priors.horizon import Objective, follow
from train.priors.plant import SUBSTEP_S, WRENCH_UNIT, Motion, PriorPlant

TARGET_COST = 10.0
# Price of a squared unit of wrench, in the first pass and in the last.
WRENCH_COST_FIRST, WRENCH_COST_LAST = 1.0, 1e3
# Ticks of a plan, and how many times dearer the wrench becomes with a pass; the next where that loses the robot.
PACES = ((8, 6.0), (8, 2.5), (12, 2.5), (16, 1.6))
# A pass may cost this much more than the motion it began with, at the same price; who falls costs many times more.
DEARER_MAX = 1.2
LIFT_SMOOTHING_TICKS = 3.0
# A motion that leans on the wrench anywhere, for half a second, is no better an aim than the reference.
HELPER_FORCE_MAX_N = 5.0
LEANING_TICKS = 25
# Less than this, the weight of 50 g, is no help: a dearer wrench would change nothing.
NO_HELP_N = 0.5


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
    """Find the nearest motion to ``wanted`` that the nominal robot makes by itself. Takes some minutes.

    Where none is found, as for motions with flight, it returns ``wanted`` and says so.

    Args:
        robot: its nominal model is used.
        wanted: the motion and joint targets to start from.
        lift_m: (K+1,) height correction that puts the motion on the ground.
        threads: worker threads.
        progress: told one line a pass.
    """
    qpos, qvel, _ = generalized_motion(wanted.reference)
    qpos[:, 2] += gaussian_filter1d(lift_m, LIFT_SMOOTHING_TICKS)
    plant = PriorPlant(robot, round(wanted.reference.dt_s / SUBSTEP_S), threads, wanted.reference.scene)
    no_wrench = np.zeros((len(qpos) - 1, len(WRENCH_UNIT)))
    found = _faded(plant, Motion(qpos, qvel, np.hstack([wanted.targets_rad[:-1], no_wrench])), progress)
    if found is None or _leaning_n(found) > HELPER_FORCE_MAX_N:
        progress("feasible motion: none found; the base action aims at the reference")
        return wanted
    return Nominal.of(wanted.reference, found.qpos, found.qvel, found.command[:, : -len(WRENCH_UNIT)])


def _faded(plant: PriorPlant, wanted: Motion, progress: Callable[[str], None]) -> Motion | None:
    """The motion at the highest price of the wrench that was reached; ``None`` where not even the first was."""
    motion, price = None, 0.0
    for horizon, dearer in PACES:
        while price < WRENCH_COST_LAST and (motion is None or _leaning_n(motion) > NO_HELP_N):
            risen = min(max(price * dearer, WRENCH_COST_FIRST), WRENCH_COST_LAST)
            made = _pass(plant, _objective(wanted, risen), motion, horizon)
            if made is None:
                progress(f"feasible motion: lost with helper price {risen:.0f}, plans of {horizon} ticks")
                break
            motion, price = made, risen
            away_mm = 1e3 * np.linalg.norm(motion.qpos[:, :3] - wanted.qpos[:, :3], axis=1).mean()
            force_n, worst_n = motion.helper_force_n().mean(), _leaning_n(motion)
            progress(
                f"feasible motion: helper price {price:.0f} of {WRENCH_COST_LAST:.0f}, root {away_mm:.0f} mm from the "
                f"reference, helper force {force_n:.1f} N, in its worst half second {worst_n:.1f} N"
            )
    return motion


def _pass(plant: PriorPlant, objective: Objective, before: Motion | None, horizon: int) -> Motion | None:
    """Follow the motion before, or the wanted one; ``None`` where that loses the robot or costs more."""
    made = follow(plant, objective, before or objective.wanted, horizon)
    # The wanted motion costs nothing, but nothing makes it: the first pass has none to be measured against.
    most = np.inf if before is None else DEARER_MAX * objective.cost(before, objective.end())
    return made if made is not None and objective.cost(made, objective.end()) < most else None


def _leaning_n(motion: Motion) -> float:
    """Helper force in the half second that leans on it most, per axis."""
    return float(uniform_filter1d(motion.helper_force_n(), LEANING_TICKS).max())


def _objective(wanted: Motion, wrench_cost: float) -> Objective:
    """Weights of squared deviations: root position (m) and rotation (rad), joints, their rates; targets and wrench."""
    nv = wanted.qvel.shape[1]
    position, velocity = np.full(nv, 4.0), np.full(nv, 0.02)
    position[:3], position[3:6] = 100.0, 50.0
    velocity[:3], velocity[3:6] = 2.0, 0.5
    command = np.full(wanted.command.shape[1], TARGET_COST)
    command[-len(WRENCH_UNIT) :] = wrench_cost
    return Objective(wanted, np.concatenate([position, velocity]), command)
