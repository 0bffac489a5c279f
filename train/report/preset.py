"""What a configuration changes against the presets in configs/train."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

from core.errors import InputError
from train.config import CONFIG_DIR, compose_document

_OWN_KEYS = ("motion", "motions", "run_dir")
_ABSENT = "absent"


@dataclass(frozen=True)
class PresetDifference:
    """One key with another value than the preset's; ``absent`` where there is none."""

    key: str
    preset: str
    here: str


def nearest_preset(document: Mapping[str, Any]) -> tuple[str, list[PresetDifference]]:
    """The preset with the fewest differences, and these; ("", []) where no preset can be read.

    Configurations do not keep the name of their preset. What the machine decides (precision, threads) is compared with
    what this machine would decide. A preset that cannot be composed is left out.
    """
    found = [(name, differences(preset, document)) for name, preset in _presets().items()]
    return min(found, key=lambda entry: len(entry[1]), default=("", []))


@cache
def _presets() -> dict[str, Mapping[str, Any]]:
    """Every preset that can be composed, by name. Composing them takes seconds, so a process does it once."""
    composed: dict[str, Mapping[str, Any]] = {}
    for path in sorted((CONFIG_DIR / "train").glob("*.yaml")):
        with suppress(InputError):
            composed[path.stem] = compose_document(["motion=stand", f"train={path.stem}"])
    return composed


def differences(preset: Mapping[str, Any], document: Mapping[str, Any]) -> list[PresetDifference]:
    """Keys with different values in the document's order, the ones it lacks at the end; lists are compared whole."""
    theirs, ours = _flat(preset), _flat(document)
    return [
        PresetDifference(key, theirs.get(key, _ABSENT), ours.get(key, _ABSENT))
        for key in dict.fromkeys([*ours, *theirs])
        if theirs.get(key) != ours.get(key) and key not in _OWN_KEYS
    ]


def _flat(section: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    """Nested mappings as dotted keys with values as text."""
    flat: dict[str, str] = {}
    for name, value in section.items():
        if isinstance(value, Mapping) and value:
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = _text(value)
    return flat


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_text(part) for part in value) + "]"
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)
