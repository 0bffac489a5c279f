"""What the figures of report.json are called, and how they read."""

from typing import Any

from motion.physics_checks import STABLE_DISTANCE_M

# Key of report.json -> what the reader sees: label, unit, meaning.
FIGURES = {
    "penetration_mm": ("penetration", "mm", "deepest point of any body below the ground, worst frame"),
    "floating_mm": ("floating", "mm", "height of the lower sole while a foot is in contact, worst frame"),
    "sliding_mm": ("sliding", "mm", "way of the middle of a sole from where its contact began, worst contact"),
    "com_cop_mm": ("CoM to CoP", "mm", f"worst frame with a body near the ground; Eq. 1: {1e3 * STABLE_DISTANCE_M:g}"),
    "airborne_frames": ("airborne", "frames", "nothing near the ground"),
    "limit_violations": ("joint limits", "frames × joints", "angles outside the joint's range"),
    "speed_violations": ("joint speeds", "frames × joints", "faster than the joint's limit from frame to frame"),
    "self_collisions": ("self-collision", "frames", "two bodies more than 1 mm inside each other, by pair"),
    "residual_torque_nm": ("residual torque", "Nm", "on the root, that the ground cannot supply, worst half second"),
    "residual_force_n": ("residual force", "N", "with that torque"),
    "residual_at_s": ("residual at", "s", "where that half second begins"),
}


def figure_text(value: Any) -> str:
    """A figure of report.json for people; a table of pairs becomes their sum and names."""
    if isinstance(value, dict):
        pairs = "; ".join(f"{pair}: {frames}" for pair, frames in value.items())
        return f"{sum(value.values())} ({pairs})" if value else "0"
    if isinstance(value, float):
        return f"{value:.1f}"
    return "none" if value is None else str(value)
