"""Settings of the last step."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FinishSettings:
    """Section `finish` of configs/motion/process.yaml; see there."""

    default_ends_s: float
    loop_blend_s: float
    stays_m: float
    same_pose_rad: float
    max_backswing_rad: float
    max_loop_drift_m: float
    max_loop_turn_rad: float
