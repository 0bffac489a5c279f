"""The wrench on the root that a motion needs and that the ground cannot supply: what no robot can do on its own.

Definition. Inverse dynamics (MuJoCo's mj_inverse) along the reference at the control period: velocities as the clip's,
accelerations the differences of the velocities after a Gaussian of two ticks. At each tick the sole points of the feet
that bear may push with any forces inside a friction pyramid (four edges along the world's x and y, friction 0.7), as
long as no joint that carries them exceeds its torque limit. Of all such forces those count that leave the smallest
wrench on the root, force (N) and torque about the root's origin (Nm) in one sum of squares, 1 N like 1 Nm: that is the
residual. A foot bears where its contact is one half or more, and, where no foot's is, if its sole is within 2 cm of the
ground. In the air the ground supplies nothing: the residual is what free fall does not explain.

The magnitudes of residual force and torque are averaged over consecutive half seconds from the clip's start; a rest
that is shorter belongs to the last one. The worst half second has the largest torque and force, as a sum of squares.

Example: where a resting robot's centre of mass is d outside the edge of its feet, the residual has the moment m g d
about that edge. A little force at a long arm counts less than a torque: with the root r (in m) from the edge, the
residual's torque is m g d / (1 + r²) and its force (in N) r times as much, as far as friction allows.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np

from motion.feet import sole_height_m
from motion.inverse_dynamics import FRICTION, generalized_motion, ground_force_map, sole_jacobians
from motion.physics_checks import phases
from motion.reference import Reference
from motion.settings import read_section
from robot.robot import Robot

WINDOW_S = 0.5
NEAR_GROUND_M = 0.02
MOST_FRICTION = 1.2
_LIMIT_WEIGHT = 1000.0  # of a torque beyond its limit, against the residual wrench
_TOLERANCE = 1.0  # N and Nm: over half a second 1 N changes the speed of 35 kg by 0.014 m/s
_BISECTIONS = 8


@dataclass(frozen=True)
class ResidualSettings:
    """Section `residual_wrench` of configs/motion/process.yaml; see there."""

    max_torque_nm: float
    max_force_n: float


@dataclass(frozen=True, eq=False)
class Residual:
    """Mean magnitudes of the residual wrench in each of W half seconds: force_n, torque_nm (W,), from start_s (W,) to
    end_s (W,) of the clip."""

    start_s: np.ndarray
    end_s: np.ndarray
    force_n: np.ndarray
    torque_nm: np.ndarray

    @property
    def worst(self) -> int:
        """Which half second has the largest residual."""
        return int(np.hypot(self.force_n, self.torque_nm).round(2).argmax())  # where nothing is left, the first

    def impossible_spans_s(self, settings: ResidualSettings | None = None) -> list[tuple[float, float]]:
        """From when to when one of the two is above its limit; `settings` by default from the configuration."""
        limits = settings or read_section(ResidualSettings, "residual_wrench")
        beyond = phases((self.torque_nm > limits.max_torque_nm) | (self.force_n > limits.max_force_n))
        return [(float(self.start_s[first]), float(self.end_s[end - 1])) for first, end in beyond]

    def __str__(self) -> str:
        worst = self.worst
        figures = f"{self.torque_nm[worst]:.1f} Nm and {self.force_n[worst]:.1f} N"
        if figures == "0.0 Nm and 0.0 N":
            return f"the ground can supply the whole motion ({figures} are missing)"
        return f"the ground cannot supply {figures} on the root (worst half second, from {self.start_s[worst]:.1f} s)"


@dataclass(frozen=True, eq=False)
class Demand:
    """What a reference asks for at each of T ticks.

    wanted (T,6+J): generalised forces, in MuJoCo's order (force in the world, torque in the root's frame, joints);
    jacobians: of each tick, (S,3,6+J) of the S sole points on the ground; torque_limit_nm (J,).
    """

    dt_s: float
    wanted: np.ndarray
    jacobians: tuple[np.ndarray, ...]
    torque_limit_nm: np.ndarray


def demand_of(robot: Robot, reference: Reference) -> Demand:
    """Inverse dynamics of `reference`, without joint friction and joint stops."""
    model = copy.copy(robot.model)
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS
    data = mujoco.MjData(model)
    wanted, jacobians = [], []
    bearing = bearing_feet(robot, reference)
    for tick, (data.qpos[:], data.qvel[:], data.qacc[:]) in enumerate(zip(*generalized_motion(reference))):
        mujoco.mj_inverse(model, data)
        wanted.append(data.qfrc_inverse.copy())
        jacobians.append(sole_jacobians(model, data, robot, bearing[tick]))
    return Demand(reference.dt_s, np.stack(wanted), tuple(jacobians), robot.torque_limit_nm)


def bearing_feet(robot: Robot, reference: Reference) -> np.ndarray:
    """Which feet (T,2) may carry, as the module's text defines it."""
    standing = reference.contact >= 0.5
    near = sole_height_m(robot, reference).min(axis=2) <= NEAR_GROUND_M
    return standing | (~standing.any(axis=1, keepdims=True) & near)


def residual_wrench(demand: Demand, friction: float = FRICTION) -> Residual:
    """The residual of each half second, as the module's text defines it."""
    left, edges = unsupplied(demand, friction), _window_edges(demand)
    force, torque = (
        np.add.reduceat(np.linalg.norm(left[:, part], axis=1), edges[:-1]) / np.diff(edges)
        for part in (slice(3), slice(3, 6))
    )
    bounds_s = np.minimum(edges, len(left) - 1) * demand.dt_s
    return Residual(bounds_s[:-1], bounds_s[1:], force, torque)


def friction_needed(demands: Sequence[Demand], share: float = 1.0) -> float:
    """The floor for friction: the least with which so large a share of all half seconds can be supplied.

    Found by bisection to 0.005. A half second can be supplied where its mean residual (force and torque, as a sum of
    squares) is within 1 N of that with friction 1.2, the most that is looked at. The pyramid lies inside the cone:
    along the diagonals of x and y up to 1.41 times as much as the ground would need is found.
    """
    halves = [half for demand in demands for half in _half_seconds(demand)]
    open_cases = [(half, _mean_left(half, MOST_FRICTION) + _TOLERANCE) for half in halves]
    missing = math.ceil(share * len(halves))
    low, high = 0.0, MOST_FRICTION
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        enough = [_mean_left(half, middle) <= allowed for half, allowed in open_cases]
        found = sum(enough) >= missing
        # With more friction what could be supplied still can, with less what could not still cannot: that is settled.
        if found:
            high = middle
        else:
            low, missing = middle, missing - sum(enough)
        open_cases = [case for case, supplied in zip(open_cases, enough, strict=True) if supplied == found]
    return high


def unsupplied(demand: Demand, friction: float) -> np.ndarray:
    """The wrench on the root (T,6), N in the world and Nm in the root's frame, that is left."""
    left = demand.wanted[:, :6].copy()
    for tick, jacobians in enumerate(demand.jacobians):
        if len(jacobians):
            push = ground_force_map(jacobians, friction)
            left[tick] -= push[:6] @ _ground_force(push, demand.wanted[tick], demand.torque_limit_nm)
    return left


def _mean_left(demand: Demand, friction: float) -> float:
    return float(np.linalg.norm(unsupplied(demand, friction), axis=1).mean())


def _ground_force(push: np.ndarray, wanted: np.ndarray, limit_nm: np.ndarray) -> np.ndarray:
    """Forces (n,), none negative, along the columns of `push` (6+J,n) that leave least of `wanted` (6+J,) on the root.

    Few ticks meet a torque limit: limits are added only where the forces without them break one.
    """
    from scipy.optimize import nnls  # see motion.inverse_dynamics

    force, _ = nnls(push[:6], wanted[:6])
    carrying = push[6:].any(axis=1)
    arms, load, limit = push[6:][carrying], wanted[6:][carrying], limit_nm[carrying]
    if (np.abs(load - arms @ force) <= limit).all():
        return force
    # Each bound on |load - arms force| as an equation with a slack that is not negative: arms force - slack = bound.
    sides, bounds = np.vstack([arms, -arms]), np.append(load - limit, -load - limit)
    slack = np.eye(len(sides))
    root = np.hstack([push[:6], np.zeros((6, len(sides)))])
    rows = np.vstack([root, _LIMIT_WEIGHT * np.hstack([sides, -slack])])
    found, _ = nnls(rows, np.append(wanted[:6], _LIMIT_WEIGHT * bounds), maxiter=30 * rows.shape[1])
    return found[: push.shape[1]]


def _window_edges(demand: Demand) -> np.ndarray:
    """First ticks of the half seconds and, last, the number of ticks."""
    total, length = len(demand.wanted), round(WINDOW_S / demand.dt_s)
    return np.append(np.arange(max(1, total // length)) * length, total)


def _half_seconds(demand: Demand) -> list[Demand]:
    """The demand of each."""
    parts = [slice(first, end) for first, end in pairwise(_window_edges(demand))]
    return [replace(demand, wanted=demand.wanted[part], jacobians=demand.jacobians[part]) for part in parts]
