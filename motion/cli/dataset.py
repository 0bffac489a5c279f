"""A folder of recordings as the input of motion/process: its files, what of them is done, and the manifest."""

import hashlib
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import yaml

from core.config import load_options
from core.errors import InputError
from core.files import write_whole
from motion.cli.folder import REPORT_JSON, read_report
from motion.clip_set import MANIFEST, Entry, Manifest
from motion.library import ENDINGS
from motion.npz import read_file
from motion.pipeline import ProcessRequest
from motion.report.record import TRACKABLE


def files_in(folder: Path) -> list[tuple[Path, str]]:
    """The motion files in a folder and those in it, in order, each with a clip's name: its path without ending,
    parts joined by ``_``. What begins with a dot is left out. Raises InputError where there is none."""
    found = (path for path in folder.rglob("*") if path.suffix.lower() in ENDINGS and path.is_file())
    files = sorted(path for path in found if not any(part[0] == "." for part in path.relative_to(folder).parts))
    if not files:
        raise InputError("no motion file", where=folder, expected=f"files that end in {', '.join(ENDINGS)}")
    return [(path, "_".join(path.relative_to(folder).with_suffix("").parts)) for path in files]


def done_already(request: ProcessRequest, folder: Path) -> str | None:
    """The verdict of an earlier result of the same file, options and settings; None where there is none."""
    report = read_report(folder / REPORT_JSON)
    if report is None or not isinstance(report.get("input"), dict):
        return None
    same = (
        report["input"].get("sha256") == hashlib.sha256(read_file(request.file)).hexdigest()
        and report.get("options") == request.options()
        and report.get("settings_sha256") == request.settings_sha256()
    )
    verdict = report.get("verdict")
    return verdict if same and isinstance(verdict, str) else None


def read_manifest(parent: Path) -> tuple[Entry, ...]:
    """What the manifest in ``parent`` lists; nothing where there is none. Raises InputError naming file and entry."""
    path = parent / MANIFEST
    return load_options(Manifest, path).clips if path.is_file() else ()


def write_manifest(parent: Path, names: Sequence[str], licence: str) -> int:
    """List every trackable result that lies in ``parent``; how many of ``names``, the ones just made, are among them.

    What the manifest said of others stays, and what it lists from elsewhere; those just made get the ``licence``, if
    any. Without a clip there is no manifest. Raises InputError as read_manifest.
    """
    entries = {entry.name: entry for entry in read_manifest(parent) if (parent / entry.file).is_file()}
    for folder in sorted(parent.iterdir()):
        name, clip = folder.name, folder / f"{folder.name}.npz"
        report = read_report(folder / REPORT_JSON)
        if report is None:
            continue
        entry = entries.pop(name, Entry(""))
        if report.get("verdict") == TRACKABLE and clip.is_file():
            sha256 = hashlib.sha256(clip.read_bytes()).hexdigest()
            terms = licence if licence and name in names else entry.licence
            entries[name] = replace(entry, file=f"{name}/{name}.npz", sha256=sha256, licence=terms)
    path = parent / MANIFEST
    if entries:
        clips = [_plain(entries[name]) for name in sorted(entries)]
        write_whole(path, yaml.safe_dump({"clips": clips}, sort_keys=False, allow_unicode=True).encode())
    else:
        path.unlink(missing_ok=True)
    return len(entries.keys() & set(names))


def _plain(entry: Entry) -> dict[str, Any]:
    """What is not as usual of it."""
    values = {field.name: (getattr(entry, field.name), field.default) for field in fields(Entry)}
    return {name: value for name, (value, usual) in values.items() if value != usual}
