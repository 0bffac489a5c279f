"""YAML files into frozen dataclasses: unknown, missing and ill-typed entries are refused by name."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from core.errors import InputError

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
T = TypeVar("T")


def config_file(folder: str, name_or_file: str | Path) -> Path:
    """`configs/<folder>/<name>.yaml`, or the file itself. Raises InputError naming the files that exist."""
    path = Path(name_or_file)
    if path.suffix in (".yaml", ".yml"):
        if not path.is_file():
            raise InputError("no such file", where=path)
        return path
    bundled = CONFIGS / folder / f"{name_or_file}.yaml"
    if not bundled.is_file():
        names = ", ".join(sorted(file.stem for file in (CONFIGS / folder).glob("*.yaml")))
        raise InputError(
            f"unknown {folder} configuration", got=name_or_file, expected=f"one of {names}, or a .yaml file"
        )
    return bundled


def load_options(cls: type[T], path: Path) -> T:
    """Read a YAML mapping into the dataclass `cls`. Raises InputError naming file and entry."""
    try:
        content = OmegaConf.to_container(OmegaConf.load(path), resolve=True)
    except (OSError, YAMLError, OmegaConfBaseException, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", where=path) from error
    return from_mapping(cls, content, str(path))


def from_mapping(cls: type[T], content: Any, where: str) -> T:
    """Build `cls` from a mapping that has exactly its fields (those with defaults may be left out)."""
    if not isinstance(content, Mapping):
        raise InputError("wrong kind of entry", where=where, got=content, expected="a mapping")
    fields = {field.name: field for field in dataclasses.fields(typing.cast(Any, cls))}
    if unknown := [str(key) for key in content if key not in fields]:
        raise InputError("unknown entry", where=where, got=", ".join(unknown), expected=f"some of {', '.join(fields)}")
    missing = [
        name
        for name, field in fields.items()
        if name not in content and field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise InputError(f"missing entry {', '.join(missing)}", where=where)
    hints = typing.get_type_hints(cls)
    return cls(**{name: _convert(hints[name], value, f"{where}: {name}") for name, value in content.items()})


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        if value is None and type(None) in arguments:
            return None
        return _convert(next(a for a in arguments if a is not type(None)), value, where)
    if dataclasses.is_dataclass(hint):
        return from_mapping(typing.cast(type, hint), value, where)
    if origin is tuple:
        return _convert_tuple(arguments, value, where)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not hint:
        raise InputError("wrong kind of value", where=where, got=repr(value), expected=hint.__name__)
    return value


def _convert_tuple(arguments: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise InputError("wrong kind of value", where=where, got=repr(value), expected="a list")
    if arguments[-1] is Ellipsis:
        return tuple(_convert(arguments[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if len(value) != len(arguments):
        raise InputError("wrong length", where=where, got=len(value), expected=f"{len(arguments)} numbers")
    return tuple(_convert(hint, item, f"{where}[{i}]") for i, (hint, item) in enumerate(zip(arguments, value)))
