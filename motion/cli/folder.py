"""The folder of a processed motion: it appears whole, and takes the place of nothing but its own kind."""

import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from core.errors import InputError
from core.files import umask
from motion.report.record import CREATED_BY

REPORT_JSON, REPORT_HTML = "report.json", "report.html"
MAX_REPORT_BYTES = 64 * 2**20


def check_folder(folder: Path, *, makes_parent: bool = False) -> None:
    """Raise InputError unless results may go to `folder`: new, empty, or made by motion/process and left alone.

    The folder is replaced as a whole, so that it can be neither the working directory nor a mount point.

    `makes_parent`: the folder around it may be missing.
    """
    if folder.is_dir():
        held = {path.name for path in folder.iterdir()}
        if held and not _made_here(folder, held):
            expected = "a new or empty folder, or one that motion/process made and that holds nothing else"
            raise InputError("folder is in use", where=folder, got=", ".join(sorted(held)[:5]), expected=expected)
        place = folder.resolve()
        if place == Path.cwd() or place.is_mount():
            got = "the working directory" if place == Path.cwd() else "a mount point"
            raise InputError("cannot be replaced", where=folder, got=got, hint="name a folder in it")
    elif folder.exists() or folder.is_symlink():
        raise InputError("is a file", where=folder, expected="a folder")
    parent = folder.absolute().parent
    if makes_parent and not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise InputError("no such folder", where=folder, got=parent, hint="make it first")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise InputError("folder is not writable", where=folder, got=parent)


def write_folder(folder: Path, files: Mapping[str, bytes], *, makes_parent: bool = False) -> None:
    """Make `folder` hold exactly `files`, or leave it as it was. Raises InputError as check_folder, and OSError."""
    check_folder(folder, makes_parent=makes_parent)
    folder = folder.resolve()
    folder.parent.mkdir(exist_ok=True)
    fresh = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    old = fresh.with_name(f"{fresh.name}.old")
    try:
        for name, content in files.items():
            (fresh / name).write_bytes(content)
        fresh.chmod(0o777 & ~umask())
        if folder.exists():
            folder.rename(old)
        try:
            fresh.rename(folder)
        except OSError:
            if old.exists():
                old.rename(folder)
            raise
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _made_here(folder: Path, held: set[str]) -> bool:
    """Whether it is a result of motion/process, with no file of anybody else's."""
    others = held - {REPORT_JSON, REPORT_HTML}
    if len(others) > 1 or any(Path(name).suffix != ".npz" for name in others):
        return False
    return read_report(folder / REPORT_JSON) is not None


def read_report(path: Path) -> dict[str, Any] | None:
    """The content of a report.json that motion/process wrote; None where there is none."""
    try:
        if path.stat().st_size > MAX_REPORT_BYTES:
            return None
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and content.get("created_by") == CREATED_BY else None
