"""What of a motion an actor is told. Each part may be hidden; the actor sees which are not (MaskedMimic, section 4)."""

from __future__ import annotations

import numpy as np

from core.errors import InputError

# Points of the body in the order of a robot's `goal_points`.
POINTS = ("left_hand", "right_hand", "head", "left_foot", "right_foot")

# joints: their positions, speeds and feed-forward; posture: height and lean of the root; heading: its own and how fast
# all of it turns; place: its velocity; steer: smooth speed, turn and heading of the whole movement; then where each
# point is, and how it is turned.
PARTS = ("joints", "posture", "heading", "place", "steer", *POINTS, *(f"{point}_turn" for point in POINTS))

BODY = tuple(part for part in PARTS if part not in ("joints", "steer"))
KINDS: dict[str, tuple[str, ...]] = {
    "full": ("joints", *BODY),
    "body": BODY,
    "root": ("posture", "heading", "place"),
    "path": ("heading", "place"),
    "vr3": ("head", "head_turn", "left_hand", "right_hand"),
    "reach": ("steer", "right_hand"),
    "steer": ("steer",),
    "none": (),
}


def bits_of(parts: tuple[str, ...]) -> int:
    """A set of parts as one number: bit k is part k of :data:`PARTS`."""
    return sum(1 << PARTS.index(part) for part in parts)


def visible_in(kind: str) -> np.ndarray:
    """Which parts (V,) a kind of goal shows: 1 or 0. Raises InputError for a kind that is none."""
    if kind not in KINDS:
        raise InputError("no such kind of goal", got=kind, expected=f"one of {', '.join(KINDS)}")
    return np.array([part in KINDS[kind] for part in PARTS], dtype=np.float64)
