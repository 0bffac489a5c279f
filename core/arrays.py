"""Checks of arrays that cross a room's border."""

import numpy as np


def check_shape(owner: str, name: str, value: np.ndarray, expected: tuple[int, ...]) -> None:
    """Raise ValueError unless ``value`` has the shape ``expected``."""
    if value.shape != expected:
        raise ValueError(f"{owner}.{name}: got shape {value.shape}, expected {expected}")
