"""A clip as a goal: all of it, or of each tick only some parts."""

import hashlib

import numpy as np

from core.rotations import quat_rotate_inverse
from deploy.goals.source import Goal
from deploy.safety.rules import Asked, up_in_base
from motion.clip import Clip
from motion.reference import Reference
from policy.goals import visible_in


class ClipGoal:
    """A GoalSource that plays a clip once by its own clock; beyond its end it stays there.

    kind: what of it is shown, see :data:`policy.goals.KINDS`.
    """

    resting = False

    def __init__(
        self, name: str, clip: Clip, reference: Reference, start_pose_rad: np.ndarray, kind: str = "full"
    ) -> None:
        whole = kind == "full"
        self.name = name if whole else f"{name}:{kind}"
        self.sha256 = clip.sha256 if whole else hashlib.sha256(f"{clip.sha256}:{kind}".encode()).hexdigest()
        self.clip: Clip | None = clip
        self.reference: Reference | None = reference
        self.setting = reference
        self.start_pose_rad = start_pose_rad
        self._visible = visible_in(kind)
        self._asked = asked_by(reference)
        self._tick = 0

    @property
    def finished(self) -> bool:
        """See GoalSource."""
        return self._tick >= self.setting.num_ticks

    @property
    def asked(self) -> Asked:
        """See GoalSource."""
        return self._asked[min(self._tick, self.setting.num_ticks)]

    def start(self) -> None:
        """See GoalSource."""
        self._tick = 0

    def give_way(self) -> None:
        """See GoalSource: a clip goes on, as it rests nowhere but at its end."""

    def next(self, yaw_rad: float) -> Goal:
        """See GoalSource."""
        self._tick += 1
        return self.at(self._tick - 1)

    def at(self, tick: int) -> Goal:
        """What is shown at a tick, at phase min(1, k dt / duration)."""
        phase = min(1.0, tick * self.setting.dt_s / self.setting.duration_s)
        return Goal(self.setting, tick, phase, self._visible, clip=self.name)


def asked_by(reference: Reference) -> tuple[Asked, ...]:
    """What a clip asks of the body at each of its K+1 ticks."""
    ang_vel_b = quat_rotate_inverse(reference.root_quat_wxyz, reference.root_ang_vel_w)
    rows = zip(map(up_in_base, reference.root_quat_wxyz), ang_vel_b, reference.joint_vel_rad_s, strict=True)
    return tuple(Asked(*row) for row in rows)
