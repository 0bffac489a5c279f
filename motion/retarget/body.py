"""The robot's body at one pose: its points and distances, and how they change, from MuJoCo's kinematics and collisions.

Degrees of freedom (nv = 6+J) are MuJoCo's: the root's velocity in the world, its angular velocity in its own frame, the
joints.
"""

import mujoco
import numpy as np

from robot.robot import Robot
from world.model import build_spec

ROOT_DOFS = 6
# (p @ _CROSS) @ a = a x p
_CROSS = np.array([
    [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
    [[0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
    [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
])  # fmt: skip


class Body:
    """One robot above its floor. Pairs of shapes nearer than `look_ahead_m` count as near.

    Shapes that one of the joints in `given` (J,) moves are not watched.
    """

    def __init__(self, robot: Robot, look_ahead_m: float, given: np.ndarray) -> None:
        self.model = build_spec(robot).compile()
        self.model.geom_margin[:] = look_ahead_m / 2.0  # the margins of a pair add up
        self.data = mujoco.MjData(self.model)
        self.nv = self.model.nv
        self._moves = _moved_bodies(self.model)
        unwatched = self._moves[self.model.geom_bodyid, ROOT_DOFS:] @ given > 0
        self.model.geom_contype[unwatched] = self.model.geom_conaffinity[unwatched] = 0
        self._turning = np.zeros((self.nv, 3))
        self._moving = np.zeros((3, self.nv))

    def pose(self, qpos: np.ndarray) -> None:
        """Take the pose `qpos` (7+J,)."""
        data = self.data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, data)
        center = np.zeros((self.nv, 3))
        self._turning[3:ROOT_DOFS], self._turning[ROOT_DOFS:] = data.xmat[1].reshape(3, 3).T, data.xaxis[1:]
        center[3:ROOT_DOFS], center[ROOT_DOFS:] = data.xpos[1], data.xanchor[1:]
        self._moving = np.cross(center, self._turning).T
        self._moving[:, :3] = np.eye(3)

    def points_w(self, bodies: np.ndarray, offsets_m: np.ndarray) -> np.ndarray:
        """Where points (K,3) in the frames of bodies (K,) are in the world (K,3)."""
        turned = self.data.xmat[bodies].reshape(-1, 3, 3) @ offsets_m[:, :, None]
        return self.data.xpos[bodies] + turned[:, :, 0]

    def turn_jacobians(self, bodies: np.ndarray) -> np.ndarray:
        """Angular velocities (K,3,nv) in the world of bodies (K,) per unit of each degree of freedom."""
        return self._turning.T * self._moves[bodies, None]

    def point_jacobians(self, points_w: np.ndarray, bodies: np.ndarray) -> np.ndarray:
        """Velocities (K,3,nv) of world points (K,3) that move with bodies (K,) per unit of each degree of freedom."""
        swung = (points_w @ _CROSS.reshape(3, 9)).reshape(-1, 3, 3) @ self._turning.T
        return (swung + self._moving) * self._moves[bodies, None]

    def distances(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distances (C,) of near pairs in m, their Jacobians (C,nv), and True (C,) where one of a pair is the floor."""
        mujoco.mj_collision(self.model, self.data)
        contact = self.data.contact
        bodies = self.model.geom_bodyid[contact.geom]
        both = self.point_jacobians(np.concatenate((contact.pos, contact.pos)), bodies.T.ravel())
        apart = both[len(bodies) :] - both[: len(bodies)]
        return contact.dist.copy(), (contact.frame[:, None, :3] @ apart)[:, 0], (bodies == 0).any(axis=1)

    def moved(self, qpos: np.ndarray, step: np.ndarray) -> np.ndarray:
        """`qpos` (7+J,) after a step (nv,)."""
        there = qpos.copy()
        mujoco.mj_integratePos(self.model, there, step, 1.0)
        return there

    def way(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """The step (nv,) from one qpos (7+J,) to another."""
        step = np.empty(self.nv)
        mujoco.mj_differentiatePos(self.model, step, 1.0, before, after)
        return step


def _moved_bodies(model: mujoco.MjModel) -> np.ndarray:
    """(nbody,nv) 1 where a degree of freedom moves a body, else 0."""
    moves = np.zeros((model.nbody, model.nv))
    for body in range(1, model.nbody):
        moves[body] = moves[model.body_parentid[body]]
        first, count = model.body_dofadr[body], model.body_dofnum[body]
        moves[body, first : first + count] = 1.0
    return moves
