"""Files that appear whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robot.errors import InputError


def check_output_path(path: Path, suffixes: tuple[str, ...]) -> None:
    """Raise InputError unless ``path`` has one of ``suffixes`` and its folder exists."""
    if path.suffix.lower() not in suffixes:
        raise InputError("unknown kind of file", where=path, got=path.suffix or "none", expected=" or ".join(suffixes))
    if not path.parent.is_dir():
        raise InputError("no such folder", where=path, got=path.parent, hint="create it first")


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A path beside ``path`` to write to; it becomes ``path`` at the end, or goes when an error ends the block."""
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
