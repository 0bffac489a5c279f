"""Where each reference stands: it comes after a robot that was pushed away."""

from dataclasses import replace

import torch

from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate, yaw_of
from train.mdp.tick import ReferenceRows

UP = torch.tensor([0.0, 0.0, 1.0])


class Anchor:
    """Moves references over the ground and turns them about the vertical, with an exponential lag behind the robots.

    No actor sees its place or heading. A robot that saved itself by a step cannot know that it now stands elsewhere,
    and with a reference that stays behind, nothing that it does there is worth anything.

    Args:
        num_envs: B.
        time_s: time constant; None: the references stay.
        dt_s: control period.
    """

    def __init__(self, num_envs: int, time_s: float | None, dt_s: float) -> None:
        self._share = None if time_s is None else min(1.0, dt_s / time_s)
        self.place_m = torch.zeros(num_envs, 3)
        self.heading_rad = torch.zeros(num_envs)

    def moved(self, rows: ReferenceRows) -> ReferenceRows:
        """The rows (B) of the clips where their anchors have taken them."""
        if self._share is None:
            return rows
        turn = quat_from_axis_angle(UP, self.heading_rad)
        turns, places = turn[:, None], self.place_m[:, None]
        return replace(
            rows,
            root_pos_w=quat_rotate(turn, rows.root_pos_w) + self.place_m,
            root_quat_wxyz=quat_mul(turn, rows.root_quat_wxyz),
            root_lin_vel_w=quat_rotate(turn, rows.root_lin_vel_w),
            root_ang_vel_w=quat_rotate(turn, rows.root_ang_vel_w),
            body_pos_w=quat_rotate(turns, rows.body_pos_w) + places,
            body_quat_wxyz=quat_mul(turns, rows.body_quat_wxyz),
            body_lin_vel_w=quat_rotate(turns, rows.body_lin_vel_w),
            body_ang_vel_w=quat_rotate(turns, rows.body_ang_vel_w),
        )

    def follow(self, root_pos_w: torch.Tensor, root_quat_wxyz: torch.Tensor, moved: ReferenceRows) -> None:
        """Come nearer to roots (B, 3), (B, 4) by one control period; ``moved``: the rows they are compared with."""
        if self._share is None:
            return
        off = yaw_of(root_quat_wxyz) - yaw_of(moved.root_quat_wxyz)
        turn = self._share * torch.atan2(torch.sin(off), torch.cos(off))
        away = self._share * (root_pos_w - moved.root_pos_w)
        away[:, 2] = 0.0
        from_anchor = quat_rotate(quat_from_axis_angle(UP, turn), moved.root_pos_w - self.place_m)
        self.place_m = moved.root_pos_w + away - from_anchor
        self.heading_rad = self.heading_rad + turn

    def restart(self, env_ids: torch.Tensor) -> None:
        """Take the references of ``env_ids`` back to where their clips have them."""
        self.place_m[env_ids] = 0.0
        self.heading_rad[env_ids] = 0.0
