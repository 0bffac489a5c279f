"""Tables of a reference that take long to make and that only some actors look at."""

from collections.abc import Set

from motion.feedforward import with_feedforward
from motion.reference import Reference
from motion.steering import with_steering
from robot.robot import Robot


def with_tables(robot: Robot, reference: Reference, names: Set[str]) -> Reference:
    """The reference with its tables of these ``names``: ``feedforward_rad``, ``steering``, both, or none."""
    reference = with_feedforward(robot, reference) if "feedforward_rad" in names else reference
    return with_steering(reference) if "steering" in names else reference
