"""Forward kinematics of the tracked points, batched, for numpy and torch arrays alike.

Inside, arrays are (component, body, sample): whole components are contiguous, and bodies are grouped by
their depth in the tree, so that a call costs a few array operations per level of the tree whatever
the number of bodies or samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import mujoco
import numpy as np

from core.errors import InputError
from core.rotations import Array, array_module, cross_parts, mul_parts, quat_rotate, rotate_parts


@dataclass(frozen=True)
class TrackedPoint:
    """A point fixed to body ``parent`` at ``offset_m`` (3,) in that body's frame."""

    name: str
    parent: str
    offset_m: tuple[float, float, float]


class BodyState(NamedTuple):
    """State of the tracked points, (..., P, 3 or 4), world frame. Velocities are None where not asked for.

    ``lin_vel_w`` is the velocity of each body's origin in m/s, ``ang_vel_w`` in rad/s.
    """

    pos_w: Array
    quat_wxyz: Array
    lin_vel_w: Array | None
    ang_vel_w: Array | None


class _Constants(NamedTuple):
    """The model's numbers; the bodies below the root, and their joints, sorted by depth."""

    joints: Array  # (J,) joint table row of each
    parents: tuple[Array, ...]  # per level: where each parent stands in the level above
    body_pos: Array  # (3, J, 1) origin in the parent's frame
    body_quat: Array  # (4, J, 1) rotation in the parent's frame at joint angle zero
    axis: Array  # (3, J, 1) in the body's frame
    mjcf_order: Array  # (B,) row of each body of the MJCF
    point_bodies: Array  # (P,) row of each point's body
    point_offset: Array  # (3, P, 1) in the frame of its body


class Kinematics:
    """Where every body of ``model`` and every one of ``points`` is, given root and joints.

    Accepts numpy arrays or torch tensors of any floating type and device with any leading dimensions;
    answers with the same kind, bodies first. ``where`` is named by the InputError of a model that does not fit.
    """

    def __init__(self, model: mujoco.MjModel, points: Sequence[TrackedPoint], *, where: str) -> None:
        _check_joints(model, where)
        self._num_bodies = model.nbody - 1
        self._mass_fraction = model.body_mass[1:] / model.body_mass.sum()
        self._com_offset_m = model.body_ipos[1:].copy()
        self._numpy, bounds = _constants(model, points)
        self._levels = tuple(pairwise(bounds))
        self._cache: dict[Any, _Constants] = {}

    def forward(
        self,
        root_pos_w: Array,
        root_quat_wxyz: Array,
        joint_pos_rad: Array,
        root_lin_vel_w: Array | None = None,
        root_ang_vel_w: Array | None = None,
        joint_vel_rad_s: Array | None = None,
    ) -> BodyState:
        """Poses, and velocities when all three velocity arguments are given.

        ``root_pos_w`` (..., 3), ``root_quat_wxyz`` (..., 4) unit, ``joint_pos_rad`` (..., J); the root's
        velocities (..., 3) are both in the world frame, the linear one that of the root body's origin.
        """
        c = self._constants(joint_pos_rad)
        batch = tuple(joint_pos_rad.shape[:-1])
        root = _columns(root_pos_w)[:, None], _columns(root_quat_wxyz)[:, None]
        pos, quat = self._poses(c, *root, _columns(joint_pos_rad)[c.joints])
        arm = array_module(pos).stack(rotate_parts(quat[:, c.point_bodies], c.point_offset))
        pos_w, quat_wxyz = _rows(c, pos, arm, batch), _rows(c, quat, 0.0, batch)
        if root_lin_vel_w is None or root_ang_vel_w is None or joint_vel_rad_s is None:
            return BodyState(pos_w, quat_wxyz, None, None)
        root = _columns(root_lin_vel_w)[:, None], _columns(root_ang_vel_w)[:, None]
        lin_vel, ang_vel = self._velocities(c, pos, quat, *root, _columns(joint_vel_rad_s)[c.joints])
        swing = array_module(pos).stack(cross_parts(ang_vel[:, c.point_bodies], arm))
        return BodyState(pos_w, quat_wxyz, _rows(c, lin_vel, swing, batch), _rows(c, ang_vel, 0.0, batch))

    def center_of_mass_of(self, state: BodyState) -> Array:
        """Centre of mass (..., 3) of the whole robot, of a state that ``forward`` has computed."""
        quat = state.quat_wxyz[..., : self._num_bodies, :]
        fraction, offset = _like(quat, self._mass_fraction), _like(quat, self._com_offset_m)
        com = state.pos_w[..., : self._num_bodies, :] + quat_rotate(quat, offset)
        return (fraction[:, None] * com).sum(-2)

    def _poses(self, c: _Constants, pos: Array, quat: Array, angle_rad: Array) -> tuple[Array, Array]:
        """Positions (3, B, N) and rotations (4, B, N), sorted by depth, from those of the root (·, 1, N)."""
        xp = array_module(quat)
        sine = xp.sin(0.5 * angle_rad)
        turn = mul_parts(c.body_quat, (xp.cos(0.5 * angle_rad), *(sine * part for part in c.axis)))
        all_pos, all_quat = [pos], [quat]
        for (start, stop), parents in zip(self._levels, c.parents):
            pos, quat = pos[:, parents], quat[:, parents]
            pos = pos + xp.stack(rotate_parts(quat, c.body_pos[:, start:stop]))
            quat = xp.stack(mul_parts(quat, [part[start:stop] for part in turn]))
            all_pos.append(pos)
            all_quat.append(quat)
        return xp.concatenate(all_pos, 1), xp.concatenate(all_quat, 1)

    def _velocities(
        self, c: _Constants, pos: Array, quat: Array, lin_vel: Array, ang_vel: Array, speed_rad_s: Array
    ) -> tuple[Array, Array]:
        """Linear and angular velocities (3, B, N), sorted by depth, from those of the root (3, 1, N)."""
        xp = array_module(pos)
        spin = xp.stack(rotate_parts(quat[:, 1:], c.axis)) * speed_rad_s
        all_lin, all_ang, above = [lin_vel], [ang_vel], pos[:, :1]
        for (start, stop), parents in zip(self._levels, c.parents):
            here = pos[:, 1 + start : 1 + stop]
            lin_vel, ang_vel = lin_vel[:, parents], ang_vel[:, parents]
            lin_vel = lin_vel + xp.stack(cross_parts(ang_vel, here - above[:, parents]))
            ang_vel = ang_vel + spin[:, start:stop]
            all_lin.append(lin_vel)
            all_ang.append(ang_vel)
            above = here
        return xp.concatenate(all_lin, 1), xp.concatenate(all_ang, 1)

    def _constants(self, like: Array) -> _Constants:
        """The model's numbers as the same kind of array as ``like``."""
        key = (like.dtype, getattr(like, "device", None))
        if key not in self._cache:
            self._cache[key] = _Constants(
                *(tuple(_like(like, a) for a in item) if isinstance(item, tuple) else _like(like, item)
                  for item in self._numpy)
            )  # fmt: skip
        return self._cache[key]


def _columns(a: Array) -> Array:
    """(..., n) as contiguous (n, N)."""
    return _contiguous(a.reshape(-1, a.shape[-1]).T)


def _rows(c: _Constants, bodies: Array, points_relative: Array | float, batch: tuple[int, ...]) -> Array:
    """Bodies (n, B, N) in the MJCF's order, then the points as their body plus ``points_relative``: (..., B + P, n)."""
    points = bodies[:, c.point_bodies] + points_relative
    rows = array_module(bodies).concatenate([bodies[:, c.mjcf_order], points], 1).swapaxes(0, 2)
    return _contiguous(rows).reshape(*batch, *rows.shape[1:])


def _contiguous(a: Array) -> Array:
    return np.ascontiguousarray(a) if isinstance(a, np.ndarray) else a.contiguous()


def _like(array: Array, values: np.ndarray) -> Array:
    """``values`` as the kind, type (unless one of both is of whole numbers) and device of ``array``."""
    whole = values.dtype.kind == "i"
    if isinstance(array, np.ndarray):
        return values if whole or array.dtype.kind != "f" else values.astype(array.dtype)
    return array_module(array).as_tensor(values, dtype=None if whole else array.dtype, device=array.device)


def _check_joints(model: mujoco.MjModel, where: str) -> None:
    """The recursion takes one hinge per body, at the body's origin."""
    one_each = np.array_equal(model.jnt_bodyid, np.arange(1, model.nbody))
    if not one_each or np.any(model.jnt_pos[1:]):
        expected = "one hinge on every body but the root, at the body's origin"
        raise InputError("joints do not fit forward kinematics", where=where, expected=expected)


def _constants(model: mujoco.MjModel, points: Sequence[TrackedPoint]) -> tuple[_Constants, list[int]]:
    """The numbers, and where among the joints (sorted by depth) each level begins."""
    parent = model.body_parentid[1:] - 1  # body i here is MuJoCo's body i + 1; the root is 0
    depth = np.zeros(len(parent), dtype=int)
    for body in range(1, len(parent)):
        depth[body] = depth[parent[body]] + 1
    order = np.argsort(depth, kind="stable")
    levels = [np.flatnonzero(depth == d) for d in range(depth.max() + 1)]
    parents = tuple(np.searchsorted(above, parent[bodies]) for above, bodies in pairwise(levels))
    row = np.argsort(order)
    below_root = order[1:]
    constants = _Constants(
        joints=below_root - 1,
        parents=parents,
        body_pos=model.body_pos[1:][below_root].T[..., None].copy(),
        body_quat=model.body_quat[1:][below_root].T[..., None].copy(),
        axis=model.jnt_axis[below_root].T[..., None].copy(),
        mjcf_order=row,
        point_bodies=row[[model.body(point.parent).id - 1 for point in points]],
        point_offset=np.array([point.offset_m for point in points], dtype=np.float64).reshape(-1, 3).T[..., None],
    )
    return constants, list(np.cumsum([0, *(len(bodies) for bodies in levels[1:])]))
