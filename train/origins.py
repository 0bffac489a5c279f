"""Where each value of the training configuration comes from."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from core.config import CONFIGS
from train.config import with_preset

_FOLDER = CONFIGS / "train"
COMMAND_LINE = "command line"
MACHINE = "this machine"


def told(document: Mapping[str, Any], overrides: Sequence[str]) -> Iterator[str]:
    """A line for each key of the resolved document: name, value, origin (file, command line, switch or machine).

    Args:
        document: see :func:`train.config.compose_document`.
        overrides: what it was composed from.
    """
    given = dict(override.lstrip("+").partition("=")[::2] for override in with_preset(overrides))
    layers = [(str(path.relative_to(CONFIGS.parent)), _flat(_read(path))) for path in _files(given.get("train"))]
    for name, value in _flat(document).items():
        origin = _origin(name, value, given, layers) or f"sigma={document['sigma']}"
        yield f"{name} = {_shown(value)}    # {origin}"


def _origin(
    name: str, value: Any, given: Mapping[str, str], layers: Sequence[tuple[str, Mapping[str, Any]]]
) -> str | None:
    """None: from a switch."""
    parents = {name, *(name.rsplit(".", count)[0] for count in range(1, name.count(".") + 1))}
    if parents & given.keys():
        return COMMAND_LINE
    found = [(origin, layer[name]) for origin, layer in layers if name in layer]
    if not found:
        return "default of the code"
    origin, wanted = found[-1]
    if wanted == value:
        return origin
    return MACHINE if name in ("precision", "device", "threads") else None


def _files(preset: str | None) -> list[Path]:
    """The files in the order in which they overwrite each other."""
    root = _FOLDER / "config.yaml"
    choice = next(entry["train"] for entry in _read(root)["defaults"] if isinstance(entry, dict) and "train" in entry)
    return [root, *_preset(preset or choice)]


def _preset(name: str) -> list[Path]:
    path = _FOLDER / "train" / f"{name}.yaml"
    below = [entry for entry in _read(path).get("defaults", []) if entry != "_self_"]
    return [*(file for entry in below for file in _preset(entry)), path]


def _read(path: Path) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load(path.read_text())
    return content


def _flat(section: Mapping[str, Any], where: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in section.items():
        flat |= _flat(value, f"{where}{name}.") if isinstance(value, Mapping) and value else {f"{where}{name}": value}
    return flat


def _shown(value: Any) -> str:
    return yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("\n").removesuffix("\n...")
