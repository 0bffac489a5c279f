"""Where results go: checked before any work, written whole or not at all."""

import json
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from core.errors import InputError


def check_output_file(option: str, path: Path | None) -> None:
    """Raise InputError unless a file can be written there. None is fine."""
    if path is None:
        return
    if path.is_dir():
        raise InputError("is a folder", where=f"{option} {path}", expected="a file to write")
    _check_parent(option, path)


def check_output_folder(option: str, path: Path | None) -> None:
    """Raise InputError unless the folder is there or can be made in one step. None is fine."""
    if path is None:
        return
    if path.is_dir():
        _check_writable(option, path, path)
    elif path.exists():
        raise InputError("is a file", where=f"{option} {path}", expected="a folder")
    else:
        _check_parent(option, path)


def check_output_kind(path: Path, suffixes: tuple[str, ...]) -> None:
    """Raise InputError unless `path` has one of the suffixes and its folder is there."""
    if path.suffix.lower() not in suffixes:
        raise InputError("unknown kind of file", where=path, got=path.suffix or "none", expected=" or ".join(suffixes))
    if not path.parent.is_dir():
        raise InputError("no such folder", where=path, got=path.parent, hint="create it first")


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file whole. ValueError on numbers that JSON does not have."""
    write_whole(path, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())


def write_whole(path: Path, content: bytes) -> None:
    """Write a file: a reader sees the old or the new content, whatever happens in between. OSError if it cannot."""
    with replacing(path) as unfinished:
        unfinished.write_bytes(content)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file beside `path` to write; it takes the name, and the old file's mode, when all went well, or goes away."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
    os.close(handle)
    unfinished = Path(name)
    try:
        yield unfinished
        unfinished.chmod(stat.S_IMODE(path.stat().st_mode) if path.exists() else 0o666 & ~umask())
        _sync(unfinished)
        unfinished.replace(path)
        _sync(path.parent)
    finally:
        unfinished.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Until it is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def umask() -> int:
    """What the process takes away from a new file's mode."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _check_parent(option: str, path: Path) -> None:
    parent = path.absolute().parent
    if not parent.is_dir():
        raise InputError("no such folder", where=f"{option} {path}", got=parent, hint="make it first")
    _check_writable(option, path, parent)


def _check_writable(option: str, path: Path, folder: Path) -> None:
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError("folder is not writable", where=f"{option} {path}", got=folder)
