"""Settings of the pipeline's steps: a section of configs/motion/process.yaml each."""

from dataclasses import fields
from pathlib import Path
from typing import TypeVar

from core.errors import InputError
from robot.description import check_keys, finite_number, read_yaml

PROCESS = Path(__file__).resolve().parents[1] / "configs" / "motion" / "process.yaml"
Settings = TypeVar("Settings")


def read_section(kind: type[Settings], name: str, path: Path = PROCESS) -> Settings:
    """Section `name` of the file at `path` as the dataclass `kind`, all of whose fields are numbers, none negative.

    Raises InputError naming file and field: no such file or section, a field that is missing, unknown or no number.
    """
    if not path.is_file():
        raise InputError("no such file", where=path, expected="the settings of motion/process")
    table = read_yaml(path)
    if name not in table:
        raise InputError("no such section", where=path, got=", ".join(table), expected=name)
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    check_keys(table[name], set(names), where=f"{path}: {name}")
    return kind(**{field: _number(table[name][field], f"{path}: {name}: {field}") for field in names})


def _number(value: object, where: str) -> float:
    number = finite_number(value, where=where)
    if number < 0.0:
        raise InputError("negative", where=where, got=number, expected="0 or more")
    return number
