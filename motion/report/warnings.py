"""What a trackable clip may have, yet nobody should overlook."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from motion.settings import read_section


@dataclass(frozen=True)
class WarningSettings:
    """Section `warnings` of configs/motion/process.yaml; see there."""

    max_slide_m: float
    max_penetration_m: float
    max_float_m: float


def warnings_of(figures: Mapping[str, Any], settings: WarningSettings | None = None) -> tuple[str, ...]:
    """A line for each of the `figures` (the first block of report.json) that is beyond what the ground or the joints
    allow; none without a clip, whose figures are None. `settings` by default from configs/motion/process.yaml."""
    settings = settings or read_section(WarningSettings, "warnings")
    lengths = {
        "sliding_mm": (settings.max_slide_m, "a standing foot slides {:.1f} mm (at most {:g})"),
        "penetration_mm": (settings.max_penetration_m, "a body is {:.1f} mm below the ground (at most {:g})"),
        "floating_mm": (settings.max_float_m, "standing feet float {:.1f} mm above the ground (at most {:g})"),
    }
    counts = {
        "limit_violations": "joints are outside their range {} times (frames × joints)",
        "speed_violations": "joints are faster than their limit {} times (frames × joints)",
    }
    found = [
        text.format(figures[key], 1e3 * limit)
        for key, (limit, text) in lengths.items()
        if figures[key] is not None and figures[key] > 1e3 * limit
    ]
    found += [text.format(figures[key]) for key, text in counts.items() if figures[key]]
    return tuple(f"warning: {text}" for text in found)
