"""What an actor is asked to follow: the seam that clips, sticks, scripts and other programs share."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deploy.safety.rules import Asked
from motion.clip import Clip
from motion.reference import Reference


@dataclass(frozen=True, slots=True, eq=False)
class Goal:
    """What an actor looks at in one tick: row ``tick`` of ``reference`` is now.

    phase: of the motion, in [0, 1]. visible (V,): which of :data:`policy.goals.PARTS` is shown, 1 or 0. turn_rad: by
    how much the reference is turned, so that heading 0 is the robot's when the actor took over; None: its own heading
    at the first tick is the robot's. clip: the name of the clip that it is a row of; None where somebody steers.
    """

    reference: Reference
    tick: int
    phase: float
    visible: np.ndarray
    turn_rad: float | None = None
    clip: str | None = None


class GoalSource(Protocol):
    """Asked once per tick, from `start` on, by the actor that follows it.

    name: for people, logs and results. sha256: of what is followed, as far as that is known beforehand.
    reference, clip: what is scored; None where nobody knows beforehand where the robot goes.
    setting: a reference of the scene in which it happens. start_pose_rad: (J,) in the robot's joint order.
    """

    name: str
    sha256: str
    reference: Reference | None
    clip: Clip | None
    setting: Reference
    start_pose_rad: np.ndarray

    @property
    def finished(self) -> bool:
        """Whether it is over: HOLD follows at once."""
        ...

    @property
    def resting(self) -> bool:
        """Whether the stand actor may take over as soon as the robot is within its entry conditions."""
        ...

    @property
    def asked(self) -> Asked | None:
        """What is asked of the body in the coming tick; None: to stand upright at rest."""
        ...

    def start(self) -> None:
        """An actor takes over: begin anew."""
        ...

    def give_way(self) -> None:
        """The stand actor is wanted: what can rest comes to rest, and does nothing new until it starts anew."""
        ...

    def next(self, yaw_rad: float) -> Goal:
        """The goal of the coming tick. yaw_rad: the robot's heading by its IMU."""
        ...
