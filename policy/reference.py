"""The reference motion as an actor of any clip sees it: some ticks ahead of now."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate, yaw_of

Array = Any  # np.ndarray or torch.Tensor


@dataclass(frozen=True)
class ReferenceWindow:
    """The reference at K ticks ahead of now; (...) are any leading dimensions, joints in the actor's order.

    World frame, turned about the vertical so that its heading was the robot's when the actor took over.
    """

    ticks: tuple[int, ...]
    joint_pos_rad: Array  # (..., K, J)
    joint_vel_rad_s: Array  # (..., K, J)
    root_height_m: Array  # (..., K), above the scene's floor
    root_quat_wxyz: Array  # (..., K, 4)
    root_lin_vel_w: Array  # (..., K, 3)
    root_ang_vel_w: Array  # (..., K, 3)
    feedforward_rad: Array | None = None  # (..., K, J), from the joint positions to the targets that carry the motion
    bodies_quat_wxyz: Mapping[str, Array] = field(default_factory=dict)  # (..., K, 4) of those that terms look at
    # For actors that follow goals, else None. Of P points and V parts: see policy.goals.
    points_m: Array | None = None  # (..., K, P, 3), from the scene's floor under the root now
    points_quat_wxyz: Array | None = None  # (..., K, P, 4)
    steer: Array | None = None  # (..., K, 4): speed forward and left m/s, turn rad/s, heading rad
    visible: Array | None = None  # (..., V), 1 or 0

    def columns(self, ticks: Sequence[int]) -> list[int]:
        """Where ``ticks`` stand among those of the window. ValueError where one is missing."""
        return [self.ticks.index(tick) for tick in ticks]


class ReferenceMotion(Protocol):
    """A clip at every control tick: row k is the motion at k periods; joints in the robot's order."""

    @property
    def joint_pos_rad(self) -> np.ndarray: ...
    @property
    def joint_vel_rad_s(self) -> np.ndarray: ...
    @property
    def root_pos_w(self) -> np.ndarray: ...
    @property
    def root_quat_wxyz(self) -> np.ndarray: ...
    @property
    def root_lin_vel_w(self) -> np.ndarray: ...
    @property
    def root_ang_vel_w(self) -> np.ndarray: ...
    @property
    def feedforward_rad(self) -> np.ndarray | None: ...
    @property
    def body_pos_w(self) -> np.ndarray: ...
    @property
    def body_quat_wxyz(self) -> np.ndarray: ...
    @property
    def steering(self) -> np.ndarray | None: ...
    @property
    def floor_m(self) -> float: ...


def window_at(
    rows: ReferenceMotion,
    tick: int,
    ticks: tuple[int, ...],
    joints: np.ndarray,
    turn_rad: float = 0.0,
    points: np.ndarray | None = None,
    visible: np.ndarray | None = None,
    bodies: Mapping[str, int] = MappingProxyType({}),
) -> ReferenceWindow:
    """What lies ``ticks`` ahead of ``tick``; beyond the clip's end its last pose, at rest.

    ``joints``: the actor's joints as columns of ``rows``. ``turn_rad``: the robot's heading minus the clip's when the
    actor took over. ``points``: of an actor that follows goals, the points as columns of ``rows``; ``visible`` (V,).
    ``bodies``: columns of ``rows`` by name, of an actor that looks at bodies.
    """
    wanted = tick + np.array(ticks, dtype=int)
    index = np.minimum(wanted, len(rows.joint_pos_rad) - 1)
    moving = (wanted < len(rows.joint_pos_rad))[:, None]
    turn = quat_from_axis_angle(np.array([0.0, 0.0, 1.0]), np.array(turn_rad))
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    about_z = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return ReferenceWindow(
        ticks=ticks,
        joint_pos_rad=rows.joint_pos_rad[index][:, joints],
        joint_vel_rad_s=rows.joint_vel_rad_s[index][:, joints] * moving,
        root_height_m=rows.root_pos_w[index, 2] - rows.floor_m,
        root_quat_wxyz=quat_mul(turn, rows.root_quat_wxyz[index]),
        root_lin_vel_w=rows.root_lin_vel_w[index] @ about_z.T * moving,
        root_ang_vel_w=rows.root_ang_vel_w[index] @ about_z.T * moving,
        feedforward_rad=None if rows.feedforward_rad is None else rows.feedforward_rad[index][:, joints],
        bodies_quat_wxyz={name: quat_mul(turn, rows.body_quat_wxyz[index, column]) for name, column in bodies.items()},
        **({} if points is None else _goal(rows, tick, index, moving, turn_rad, turn, points, visible)),
    )


def _goal(
    rows: ReferenceMotion,
    tick: int,
    index: np.ndarray,
    moving: np.ndarray,
    turn_rad: float,
    turn: np.ndarray,
    points: np.ndarray,
    visible: np.ndarray | None,
) -> dict[str, Any]:
    """What only actors that follow goals see."""
    steering = rows.steering
    assert steering is not None, "built for an actor that follows goals"
    steer = steering[index] * np.concatenate([np.repeat(moving, 3, axis=1), np.ones_like(moving)], axis=1)
    steer[:, 3] += turn_rad
    here = rows.root_pos_w[min(tick, len(rows.root_pos_w) - 1)]
    away = rows.body_pos_w[index][:, points] - [here[0], here[1], rows.floor_m]
    return {
        "points_m": quat_rotate(turn, away),
        "points_quat_wxyz": quat_mul(turn, rows.body_quat_wxyz[index][:, points]),
        "steer": steer,
        "visible": visible,
    }


def heading_difference_rad(quat_wxyz: np.ndarray, other_wxyz: np.ndarray) -> float:
    """By how much the first heading (4,) is turned from the other one (4,), in (-pi, pi]."""
    difference = float(yaw_of(quat_wxyz) - yaw_of(other_wxyz))
    return float(np.arctan2(np.sin(difference), np.cos(difference)))
