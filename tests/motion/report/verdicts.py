"""Verdicts as the filter might give them."""

import numpy as np

from motion.filter import Verdict
from motion.plausibility import Finding


def verdict_of(
    num_frames: int, failing: tuple[int, ...] = (), reason: str = "", *, distance_m: np.ndarray | None = None
) -> Verdict:
    """One rule's verdict; the motion passes unless there is a reason."""
    finding = Finding("rule", not reason, np.array(failing, dtype=int), float(len(failing)), 2.0, reason)
    return Verdict(np.full(num_frames, 0.05) if distance_m is None else distance_m, (finding,))
