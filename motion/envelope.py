"""The range of everything that some motions ask for, and where another motion leaves it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.rotations import projected_gravity
from motion.reference import Reference
from robot.robot import Robot

Envelope = Mapping[str, tuple[float, float]]
"""Quantity → lowest and highest value, in its unit."""

TRAINED_ON = "trained_on"  # key of an actor's provenance
TOLERANCE = 0.05  # of a quantity's range: a value so little beyond is still inside


def envelope_of(references: Iterable[Reference], robot: Robot) -> dict[str, tuple[float, float]]:
    """The range over all ticks of all references, one or more."""
    tables = [_quantities(reference, robot) for reference in references]
    return {
        name: (min(float(t[name].min()) for t in tables), max(float(t[name].max()) for t in tables))
        for name in tables[0]
    }


def envelope_from(provenance: Mapping[str, Any]) -> Envelope | None:
    """What an actor's file says of its training motions, or None where it says nothing that can be read."""
    try:
        return {str(name): (float(low), float(high)) for name, (low, high) in provenance[TRAINED_ON].items()}
    except (KeyError, AttributeError, TypeError, ValueError):
        return None


@dataclass(frozen=True)
class Novelty:
    """How far a motion leaves an envelope. share: of its ticks; worst: the quantity that leaves it furthest, with its
    value and the bound, in words; empty where none does."""

    share: float
    worst: str

    def __str__(self) -> str:
        if not self.worst:
            return "all within what the actor was trained on"
        return f"{100 * self.share:.0f} % beyond what the actor was trained on, most: {self.worst}"


def novelty(reference: Reference, robot: Robot, envelope: Envelope) -> Novelty:
    """Where a reference leaves an envelope; quantities that only one of them knows do not count."""
    values = {name: column for name, column in _quantities(reference, robot).items() if name in envelope}
    outside = np.zeros(reference.num_ticks + 1, dtype=bool)
    most, worst = 0.0, ""
    for name, column in values.items():
        low, high = envelope[name]
        width = max(high - low, 1e-9)
        excess = np.maximum(low - column, column - high) / width - TOLERANCE
        outside |= excess > 0.0
        at = int(excess.argmax())
        if excess[at] > most:
            bound = low if column[at] < low else high
            most, worst = float(excess[at]), f"{name} {column[at]:.2f}, known up to {bound:.2f}"
    return Novelty(float(outside.mean()), worst)


def _quantities(reference: Reference, robot: Robot) -> dict[str, np.ndarray]:
    """(K+1,) each: angle (rad) and speed (rad/s) of every joint; height (m), tilt (rad), speeds (m/s, rad/s)."""
    joints = robot.joint_names
    upright = projected_gravity(reference.root_quat_wxyz)[..., 2]
    velocity = reference.root_lin_vel_w
    return {
        **dict(zip(joints, reference.joint_pos_rad.T, strict=True)),
        **dict(zip((f"{name} speed" for name in joints), np.abs(reference.joint_vel_rad_s).T, strict=True)),
        "height": reference.root_pos_w[:, 2] - reference.scene.floor_m,
        "tilt": np.arccos(np.clip(-upright, -1.0, 1.0)),
        "speed over the ground": np.linalg.norm(velocity[:, :2], axis=1),
        "vertical speed": np.abs(velocity[:, 2]),
        "turn rate": np.linalg.norm(reference.root_ang_vel_w, axis=1),
    }
