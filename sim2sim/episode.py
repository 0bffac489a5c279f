"""What one episode leaves behind for tables, plots and videos."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class EpisodeScore:
    """One episode, T steps long (T = 0 when it ended before its first scored step).

    scores: mean over steps by key of `motion.metrics.METRIC_KEYS`, None where it cannot be known; of an actor that
    follows goals also those of `sim2sim.goal_scores.GOAL_DEFINITIONS` that its kind of goal has.
    ended: "completed", "fall" or the name of the safety rule that tripped.
    body_error_mm (T,27): distance of each tracked point from the reference, world frame. joint_error_rad (T,J).
    qpos, ref_qpos (T,7+J): root position, root quaternion wxyz and joints, of the robot and of the aligned reference.
    """

    scores: dict[str, float | None]
    ended: str
    body_error_mm: np.ndarray
    joint_error_rad: np.ndarray
    qpos: np.ndarray
    ref_qpos: np.ndarray

    @property
    def survived(self) -> bool:
        """Whether it reached its end."""
        return self.ended == "completed"
