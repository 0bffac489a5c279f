"""What may drive a curriculum: one function each, figures of the training → level that its thresholds are for."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from train.mdp.registry import Registry


@dataclass(frozen=True)
class DriverFigures:
    """``length``: mean episode length in steps; ``survival``: see :meth:`train.mdp.failures.FailureRates.survival`."""

    length: float
    survival: float


DRIVERS: Registry[Callable[[DriverFigures], float]] = Registry("curriculum driver")


@DRIVERS
def always(_: DriverFigures) -> float:
    """One way, towards hard."""
    return math.inf


@DRIVERS
def episode_length(figures: DriverFigures) -> float:
    """Mean length in steps of about the last 10,000 episodes."""
    return figures.length


@DRIVERS
def survival(figures: DriverFigures) -> float:
    """Chance to survive at the present rates of failures."""
    return figures.survival
