"""Where each reference stands: it comes after a robot that was pushed away."""

from dataclasses import dataclass, replace

import torch

from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate, yaw_of
from policy.reference import ReferenceWindow
from train.batch import Batch, Device
from train.mdp.tick import ReferenceRows


@dataclass
class Place(Batch):
    """Where references have been moved to: (B, 3) metres, and by what turn about the vertical (B,)."""

    place_m: torch.Tensor
    heading_rad: torch.Tensor


class Anchor:
    """Moves references over the ground and turns them about the vertical, with an exponential lag behind the robots.

    No actor sees its place or heading. A robot that saved itself by a step cannot know that it now stands elsewhere,
    and with a reference that stays behind, nothing that it does there is worth anything.

    Args:
        time_s: time constant; None: the references stay.
        dt_s: control period.
        device: where the robots are.
    """

    def __init__(self, time_s: float | None, dt_s: float, device: Device) -> None:
        self._share = None if time_s is None else min(1.0, dt_s / time_s)
        self._up = torch.tensor([0.0, 0.0, 1.0], device=device)

    def at_start(self, num_envs: int) -> Place:
        """Where the clips themselves have their references, for B robots."""
        return Place(self._up.new_zeros(num_envs, 3), self._up.new_zeros(num_envs))

    def moved(self, rows: ReferenceRows, place: Place) -> ReferenceRows:
        """The rows (B) of the clips where their anchors have taken them."""
        if self._share is None:
            return rows
        turn = quat_from_axis_angle(self._up, place.heading_rad)
        turns, places = turn[:, None], place.place_m[:, None]
        return replace(
            rows,
            root_pos_w=quat_rotate(turn, rows.root_pos_w) + place.place_m,
            root_quat_wxyz=quat_mul(turn, rows.root_quat_wxyz),
            root_lin_vel_w=quat_rotate(turn, rows.root_lin_vel_w),
            root_ang_vel_w=quat_rotate(turn, rows.root_ang_vel_w),
            body_pos_w=quat_rotate(turns, rows.body_pos_w) + places,
            body_quat_wxyz=quat_mul(turns, rows.body_quat_wxyz),
            body_lin_vel_w=quat_rotate(turns, rows.body_lin_vel_w),
            body_ang_vel_w=quat_rotate(turns, rows.body_ang_vel_w),
        )

    def window(self, window: ReferenceWindow, place: Place) -> ReferenceWindow:
        """A window (B, K, ...) turned as :meth:`moved` does."""
        if self._share is None:
            return window
        turn = quat_from_axis_angle(self._up, place.heading_rad)[:, None]
        return replace(
            window,
            root_quat_wxyz=quat_mul(turn, window.root_quat_wxyz),
            root_lin_vel_w=quat_rotate(turn, window.root_lin_vel_w),
            root_ang_vel_w=quat_rotate(turn, window.root_ang_vel_w),
        )

    def followed(
        self, place: Place, root_pos_w: torch.Tensor, root_quat_wxyz: torch.Tensor, moved: ReferenceRows
    ) -> Place:
        """One control period nearer to roots (B, 3), (B, 4); ``moved``: the rows they are compared with."""
        if self._share is None:
            return place
        off = yaw_of(root_quat_wxyz) - yaw_of(moved.root_quat_wxyz)
        turn = self._share * torch.atan2(torch.sin(off), torch.cos(off))
        away = self._share * (root_pos_w - moved.root_pos_w)
        away[:, 2] = 0.0
        from_anchor = quat_rotate(quat_from_axis_angle(self._up, turn), moved.root_pos_w - place.place_m)
        return Place(moved.root_pos_w + away - from_anchor, place.heading_rad + turn)
