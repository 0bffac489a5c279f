"""A wire that takes its time: asked and renewed less often, with watchdogs that wait longer, so that a slow or shared
machine keeps up with both of its ends. Which frames there are, and what they mean, stays the same."""

from pathlib import Path

from omegaconf import OmegaConf

# wire -> what happens so many times a second in its file, and its limits in seconds.
RATES = {"dds": ("command_hz", "state_hz", "emulator.state_hz"), "can": ("rate_hz",), "dynamixel": ("rate_hz",)}
LIMITS = {"dds": ("link_timeout_s",), "can": ("watchdog_s",), "dynamixel": ("watchdog_s",)}


def slowed(wire: str, config: Path, factor: float, folder: Path) -> Path:
    """A file for both ends of a wire, like config but slower by a factor."""
    content = OmegaConf.load(config)
    for name in RATES[wire]:
        OmegaConf.update(content, name, OmegaConf.select(content, name) / factor)
    for name in LIMITS[wire]:
        OmegaConf.update(content, name, OmegaConf.select(content, name) * factor)
    path = folder / f"slow_{config.name}"
    OmegaConf.save(content, path)
    return path
