"""Everything that a reward, a termination or an observation may look at after one control step."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from motion.reference import Reference
from policy.reference import ReferenceWindow
from robot.robot import Robot
from train.batch import Batch, Device
from train.simulation.simulator import PhysicsState


@dataclass(frozen=True)
class ReferenceRows(Batch):
    """The reference at one tick per environment; the shapes of :class:`motion.reference.Reference` with B rows.

    ``feedforward_rad`` is zero where nobody asked for it.
    """

    joint_pos_rad: torch.Tensor
    joint_vel_rad_s: torch.Tensor
    root_pos_w: torch.Tensor
    root_quat_wxyz: torch.Tensor
    root_lin_vel_w: torch.Tensor
    root_ang_vel_w: torch.Tensor
    feedforward_rad: torch.Tensor
    body_pos_w: torch.Tensor
    body_quat_wxyz: torch.Tensor
    body_lin_vel_w: torch.Tensor
    body_ang_vel_w: torch.Tensor
    contact: torch.Tensor
    phase: torch.Tensor
    lift_m: torch.Tensor


@dataclass(frozen=True)
class Bodies(Batch):
    """World poses and velocities of the tracked points: (B, 27, 3), (B, 27, 4), (B, 27, 3), (B, 27, 3)."""

    pos_w: torch.Tensor
    quat_wxyz: torch.Tensor
    lin_vel_w: torch.Tensor
    ang_vel_w: torch.Tensor


class ReferenceTable:
    """References of one or more clips as one float32 table, gathered with a single index per step.

    Args:
        references: one per clip; environments carry a clip index and a tick.
        lift_m: per clip (K+1,), how far a start state is raised so that its lowest sole corner touches the ground.
        device: where the table is.
        points: of actors that follow goals, which of the tracked points; the references have their steering.

    Attributes:
        scene: what all the references stand in.
    """

    def __init__(
        self,
        references: Sequence[Reference],
        lift_m: Sequence[np.ndarray],
        device: Device,
        points: Sequence[int] | None = None,
    ) -> None:
        self.scene = references[0].scene
        self.num_ticks = torch.tensor([reference.num_ticks for reference in references], device=device)
        lengths = self.num_ticks + 2
        self._first_row = torch.cumsum(lengths, 0) - lengths
        names = [name for name in ReferenceRows.__dataclass_fields__ if name != "lift_m"]
        parts = {name: [_values(reference, name) for reference in references] for name in names}
        parts["lift_m"] = list(lift_m)
        columns = {name: torch.cat([_held(name, part, device) for part in values]) for name, values in parts.items()}
        self._shapes = {name: column.shape[1:] for name, column in columns.items()}
        self._table = torch.cat([column.reshape(len(column), -1) for column in columns.values()], dim=1)
        self._goal = None if points is None else _goal_table(references, columns, points, device)

    def rows(self, clip: torch.Tensor, tick: torch.Tensor) -> ReferenceRows:
        """Return the rows of ticks (B,) of clips (B,); ticks beyond the end give the last pose, at rest."""
        index = self._first_row[clip] + torch.minimum(tick, self.num_ticks[clip] + 1)
        row = self._table.index_select(0, index)
        sizes = [shape.numel() for shape in self._shapes.values()]
        parts = row.split(sizes, dim=1)
        return ReferenceRows(*(part.reshape(-1, *shape) for part, shape in zip(parts, self._shapes.values())))

    def window(self, clip: torch.Tensor, tick: torch.Tensor, ticks: tuple[int, ...]) -> ReferenceWindow:
        """Joints and root (B, K, ...) of clips (B,) so many ticks ahead of ticks (B,), as :meth:`rows` has them."""
        wanted = tick[:, None] + torch.tensor(ticks, device=tick.device)
        index = self._first_row[clip][:, None] + torch.minimum(wanted, self.num_ticks[clip][:, None] + 1)
        sizes = [self._shapes[name].numel() for name in _WINDOW]
        parts = self._table[:, : sum(sizes)][index].split(sizes, dim=-1)
        joint_pos, joint_vel, root_pos, root_quat, lin_vel, ang_vel, feedforward = parts
        height = root_pos[..., 2] - self.scene.floor_m
        goal = {} if self._goal is None else self._goal_at(index, self.rows(clip, tick).root_pos_w)
        return ReferenceWindow(ticks, joint_pos, joint_vel, height, root_quat, lin_vel, ang_vel, feedforward, **goal)

    def ground_m(self, places_m: torch.Tensor) -> torch.Tensor:
        """Height (...) of the highest surface of the scene at places (..., 2), by numpy as the scene has it."""
        height_m = self.scene.height_at(places_m.cpu().numpy())
        return torch.as_tensor(height_m, dtype=places_m.dtype, device=places_m.device)

    def _goal_at(self, index: torch.Tensor, here_m: torch.Tensor) -> dict[str, Any]:
        """Points and steering (B, K, ...) of table rows (B, K); places along the ground from ``here_m`` (B, 3)."""
        assert self._goal is not None
        points, steer = self._goal[index].split([self._goal.shape[1] - STEERING, STEERING], dim=-1)
        places, turns = points.unflatten(-1, (-1, 7)).split([3, 4], dim=-1)
        below = here_m.clone()
        below[:, 2] = self.scene.floor_m
        return {"points_m": places - below[:, None, None], "points_quat_wxyz": turns, "steer": steer}


# The first columns of the table.
_WINDOW = (
    "joint_pos_rad", "joint_vel_rad_s", "root_pos_w", "root_quat_wxyz", "root_lin_vel_w", "root_ang_vel_w",
    "feedforward_rad",
)  # fmt: skip


STEERING = 4  # columns: see motion.steering


def _goal_table(
    references: Sequence[Reference], columns: dict[str, torch.Tensor], points: Sequence[int], device: Device
) -> torch.Tensor:
    """A row (7 P + 4) for each one of the table: places and turns of the points, point by point, and the steering."""
    poses = torch.cat([columns["body_pos_w"][:, points], columns["body_quat_wxyz"][:, points]], dim=-1)
    steering = []
    for reference in references:
        assert reference.steering is not None
        speeds, heading = reference.steering[:, :3], reference.steering[:, 3:]
        steering.append(torch.cat([_held("_vel_", speeds, device), _held("heading", heading, device)], dim=1))
    return torch.cat([poses.flatten(1), torch.cat(steering)], dim=1)


def _values(reference: Reference, name: str) -> np.ndarray:
    values: np.ndarray | None = getattr(reference, name)
    return np.zeros_like(reference.joint_pos_rad) if values is None else values


def _held(name: str, values: np.ndarray, device: Device) -> torch.Tensor:
    """A column (K+1, ...) and one row more: the last one again, without its velocities."""
    column = torch.tensor(values, device=device).float()
    last = torch.zeros_like(column[-1:]) if "_vel_" in name else column[-1:]
    return torch.cat([column, last])


@dataclass(frozen=True)
class RobotLimits:
    """Soft limits of the joints and the groups of tracked points, as tensors."""

    pos_lower_rad: torch.Tensor
    pos_upper_rad: torch.Tensor
    vel_rad_s: torch.Tensor
    torque_nm: torch.Tensor
    default_pos_rad: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor
    hands_head: torch.Tensor
    feet: torch.Tensor

    @classmethod
    def of(cls, robot: Robot, *, torque_factor: float, device: Device) -> "RobotLimits":
        """Collect the soft limits of ``robot``; torque is limited at ``torque_factor`` of the hard limit."""
        lower, upper = robot.soft_pos_limits_rad()

        def tensor(values: object) -> torch.Tensor:
            return torch.tensor(values, device=device).float()

        def points(names: tuple[str, ...]) -> torch.Tensor:
            return torch.as_tensor(robot.tracked_index(names), device=device)

        return cls(
            pos_lower_rad=tensor(lower),
            pos_upper_rad=tensor(upper),
            vel_rad_s=tensor(robot.vel_limit_rad_s * robot.soft_limit_factor),
            torque_nm=tensor(robot.torque_limit_nm * torque_factor),
            default_pos_rad=tensor(robot.default_pos_rad),
            lower=points(robot.lower_tracked),
            upper=points(robot.upper_tracked),
            hands_head=points(robot.hand_head_tracked),
            feet=points(robot.feet),
        )


@dataclass(frozen=True)
class StepOutcome:
    """One control step of B environments, after physics and before resets.

    Attributes:
        physics: state of root and joints, contact forces.
        bodies: world poses and velocities of the tracked points.
        reference: the row that this state is compared with.
        action, last_action: (B, J) raw actions of this and the step before.
        contact: (B, 2) whether each foot is pressed on anything by more than 1 N.
        landed: (B, 2) whether it is on the ground: in contact now or a tick ago, as contacts flicker.
        first_contact: (B, 2) whether that is new.
        air_time_s: (B, 2) time in the air up to this step.
        acceleration_error_m: (B, 27, 3) second difference over control steps of the points' position errors.
        error_limit_m: how far a point may be from its reference now.
        ground_m: (B,) height of what lies under the pelvis.
        terminated: (B,) whether the episode has failed in this step.
        limits: the robot's soft limits.
    """

    physics: PhysicsState
    bodies: Bodies
    reference: ReferenceRows
    action: torch.Tensor
    last_action: torch.Tensor
    contact: torch.Tensor
    landed: torch.Tensor
    first_contact: torch.Tensor
    air_time_s: torch.Tensor
    acceleration_error_m: torch.Tensor
    error_limit_m: float
    ground_m: torch.Tensor
    terminated: torch.Tensor
    limits: RobotLimits
