"""Linear feedback along the reference: a finite-horizon LQR whose gains act on what the actor observes.

The robot is linearised with its stance feet welded to the ground. One control period of delay is part of the model.
Position and velocity of the root are not observed: they follow from the stance feet standing still.
"""

from dataclasses import dataclass, fields

import mujoco
import numpy as np

from core.rotations import projected_gravity, quat_to_matrix
from core.structured import at_least, positive
from motion.inverse_dynamics import generalized_motion
from motion.reference import Reference
from robot.robot import Robot

WELD_SOLREF = (0.01, 1.0)
STATIONARY_STEPS = 300
GRAVITY_TRUST = 0.3  # share of the tilt taken from the IMU; the rest from joints and a flat stance foot


@dataclass(frozen=True)
class FeedbackCosts:
    """Weights of squared deviations: joints (rad), CoM over the stance feet (m), its velocity, tilt (rad), targets."""

    joints: float = 4.0
    com: float = 100.0
    com_velocity: float = 10.0
    tilt: float = 20.0
    target: float = 3.0
    target_change: float = 12.0

    def __post_init__(self) -> None:
        for f in fields(self):
            at_least(f"prior.costs.{f.name}", getattr(self, f.name), 0.0)
        positive("prior.costs.target", self.target)


def add_stance_welds(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add one weld to the world per foot, which :func:`feedback_gains` switches with the contact mask."""
    for foot in robot.feet:
        spec.add_equality(
            name=f"stance_{foot}",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="world",
            name2=foot,
            solref=list(WELD_SOLREF),
        )


def feedback_gains(
    model: mujoco.MjModel,
    robot: Robot,
    reference: Reference,
    targets: np.ndarray,
    costs: FeedbackCosts,
    stride: int,
) -> np.ndarray:
    """Gains (M, J, 3 + 3 + J + J + J) at every ``stride``-th tick.

    They multiply the deviations of projected gravity, base angular velocity (base frame), joint positions, joint
    velocities and the previous target; the result is subtracted from the target.

    Args:
        model: the welded model, position-actuated, without contacts, joint friction, joint and force limits.
        robot: its description.
        reference: the motion.
        targets: (T, J) feed-forward joint targets.
        costs: weights.
        stride: ticks between gains; linearisation happens there and holds until the next.
    """
    data = mujoco.MjData(model)
    substeps = round(reference.dt_s / model.opt.timestep)
    qpos, qvel, _ = generalized_motion(reference)
    ticks = np.arange(0, len(qpos), stride)
    gains = np.empty((len(ticks), robot.num_joints, 6 + 3 * robot.num_joints))
    value: np.ndarray | None = None
    for row in range(len(ticks) - 1, -1, -1):
        tick = ticks[row]
        stance = reference.contact[tick] >= 0.5
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[tick], qvel[tick], targets[tick]
        _set_welds(model, data, robot, stance)
        transition, drive = _linearize(model, data, substeps)
        geometry = _StanceGeometry.of(model, data, robot, stance)
        weights = geometry.state_cost(costs)
        repeats = stride if value is not None else STATIONARY_STEPS
        gain, value = _riccati(transition, drive, weights, costs, value, repeats)
        gains[row] = geometry.observed(gain, reference.root_quat_wxyz[tick])
    return gains


def _set_welds(model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, stance: np.ndarray) -> None:
    """Weld each stance foot where the reference has it now."""
    mujoco.mj_kinematics(model, data)
    for foot, active in zip(robot.feet, stance):
        weld, body = model.equality(f"stance_{foot}").id, model.body(foot).id
        model.eq_data[weld, :3] = 0.0
        model.eq_data[weld, 3:6], model.eq_data[weld, 6:10] = data.xpos[body], data.xquat[body]
        data.eq_active[weld] = active
    mujoco.mj_forward(model, data)


def _linearize(model: mujoco.MjModel, data: mujoco.MjData, substeps: int) -> tuple[np.ndarray, np.ndarray]:
    """Transition (2nv, 2nv) and drive (2nv, J) of one control period with a constant target."""
    size = 2 * model.nv
    step, push = np.empty((size, size)), np.empty((size, model.nu))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, step, push, None, None)
    transition, drive = np.eye(size), np.zeros((size, model.nu))
    for _ in range(substeps):
        transition, drive = step @ transition, step @ drive + push
    return transition, drive


@dataclass(frozen=True)
class _StanceGeometry:
    """Jacobians (3, nv) of the CoM and of the mean stance foot (position and rotation), and gravity in the base."""

    com: np.ndarray
    foot: np.ndarray
    foot_rotation: np.ndarray

    @classmethod
    def of(cls, model: mujoco.MjModel, data: mujoco.MjData, robot: Robot, stance: np.ndarray) -> "_StanceGeometry":
        com, foot, rotation = (np.zeros((3, model.nv)) for _ in range(3))
        mujoco.mj_jacSubtreeCom(model, data, com, 1)
        for name in np.array(robot.feet)[stance]:
            position, turn = np.empty((3, model.nv)), np.empty((3, model.nv))
            mujoco.mj_jacBody(model, data, position, turn, model.body(name).id)
            foot += position / stance.sum()
            rotation += turn / stance.sum()
        return cls(com, foot, rotation)

    def state_cost(self, costs: FeedbackCosts) -> np.ndarray:
        """Quadratic cost (2nv, 2nv) of a deviation in position and velocity."""
        nv = self.com.shape[1]
        over_feet = self.com - self.foot
        weights = np.zeros((2 * nv, 2 * nv))
        weights[:nv, :nv] = costs.com * over_feet.T @ over_feet
        weights[nv:, nv:] = costs.com_velocity * over_feet.T @ over_feet
        weights[np.arange(6, nv), np.arange(6, nv)] += costs.joints
        weights[np.arange(3, 5), np.arange(3, 5)] += costs.tilt
        return weights

    def observed(self, gain: np.ndarray, root_quat_wxyz: np.ndarray) -> np.ndarray:
        """Gains on (gravity, angular velocity, joints, joint velocities, previous target) from state gains.

        A tilt δθ turns gravity g in the base frame by δg = g × δθ. Joint positions tell δθ too, if the stance foot
        does not turn: all of its part about the vertical, and a share of the rest, as joints are measured better.
        Root position and velocity are what keep the stance foot in place.
        """
        nv = self.com.shape[1]
        joints = nv - 6
        gravity = projected_gravity(root_quat_wxyz)
        heading = np.outer(gravity, gravity)
        trust = GRAVITY_TRUST if self.foot.any() else 1.0
        turn = np.zeros((3, 6 + 2 * joints))
        turn[:, :3] = -trust * _cross_matrix(gravity)
        from_foot = -quat_to_matrix(root_quat_wxyz).T @ self.foot_rotation[:, 6:]
        turn[:, 6 : 6 + joints] = (heading + (1.0 - trust) * (np.eye(3) - heading)) @ from_foot
        state = np.zeros((2 * nv, 6 + 2 * joints))
        state[3:6] = turn
        state[6:nv, 6 : 6 + joints] = np.eye(joints)
        state[nv + 3 : nv + 6, 3:6] = np.eye(3)
        state[nv + 6 :, 6 + joints :] = np.eye(joints)
        state[:3] = -self.foot[:, 3:] @ state[3:nv]
        state[nv : nv + 3] = -self.foot[:, 3:] @ state[nv + 3 :]
        return np.hstack([gain[:, : 2 * nv] @ state, gain[:, 2 * nv :]])


def _cross_matrix(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _riccati(
    transition: np.ndarray,
    drive: np.ndarray,
    weights: np.ndarray,
    costs: FeedbackCosts,
    value: np.ndarray | None,
    repeats: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Step the value function ``repeats`` ticks back; return the gain (J, 2nv + J) and the value.

    The state is (deviation, previous target), as a target takes effect one tick after it is computed.
    """
    size, joints = drive.shape
    a = np.zeros((size + joints, size + joints))
    a[:size, :size], a[:size, size:] = transition, drive
    q = np.zeros_like(a)
    q[:size, :size] = weights
    q[size:, size:] = costs.target_change * np.eye(joints)
    r = (costs.target + costs.target_change) * np.eye(joints)
    value = q if value is None else value
    for _ in range(repeats):
        # The new target is the previous target of the next tick: b selects the last rows.
        b_value = value[size:]
        cross = b_value @ a
        cross[:, size:] -= costs.target_change * np.eye(joints)
        gain = np.linalg.solve(r + b_value[:, size:], cross)
        value = q + a.T @ value @ a - cross.T @ gain
        value = 0.5 * (value + value.T)
    return gain, value
