"""What may be asked of a steered actor: no more than the configuration allows, nor than its training has seen."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from deploy.goals.settings import AxisSettings, GoalSettings
from motion.steering import AXES, steering_range_from

UNITS = ("m/s", "m/s", "rad/s")


def narrowed(settings: GoalSettings, provenance: Mapping[str, Any]) -> tuple[GoalSettings, str]:
    """The settings with the narrower of both ranges, and what that means in words. Rest lies in every range.

    provenance: of the actor; where it says nothing of speeds, the settings stay as they are.
    """
    seen = steering_range_from(provenance)
    if seen is None:
        return settings, f"steering: {_words(settings)}; the actor does not say which speeds it was trained on"
    forward, left, turn = (_narrower(axis, *seen[name]) for name, axis in zip(AXES, settings.axes, strict=True))
    result = replace(settings, forward=forward, left=left, turn=turn)
    changed = [name for name, before, after in zip(AXES, settings.axes, result.axes) if before != after]
    why = f"{', '.join(changed)} narrowed to what the actor was trained on" if changed else "as configured"
    return result, f"steering: {_words(result)}; {why}"


def _narrower(axis: AxisSettings, low: float, high: float) -> AxisSettings:
    return replace(axis, low=max(axis.low, min(low, 0.0)), high=min(axis.high, max(high, 0.0)))


def _words(settings: GoalSettings) -> str:
    parts = zip(AXES, settings.axes, UNITS, strict=True)
    return ", ".join(f"{name} {axis.low:.2f} to {axis.high:.2f} {unit}" for name, axis, unit in parts)
