"""Settings of the pipeline's steps: a section of configs/motion/process.yaml each."""

from pathlib import Path
from typing import TypeVar

from core.config import CONFIGS, errors_in, read_yaml
from core.structured import none_negative, pick

PROCESS = CONFIGS / "motion" / "process.yaml"
Settings = TypeVar("Settings")


def read_section(kind: type[Settings], name: str, path: Path = PROCESS) -> Settings:
    """Section `name` of the file at `path` as the dataclass `kind`, all of whose fields are numbers, none negative.

    Raises InputError naming file and field: no such file or section, a field that is missing, unknown or no number.
    """
    content = read_yaml(path)
    with errors_in(path):
        section: Settings = pick(kind, content, name)
        none_negative(section, name)
        return section
