"""A folder of recordings as the input of motion/process: its files, what of them is done, and the manifest."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import yaml

from core.errors import InputError
from core.files import write_whole
from motion.cli.folder import REPORT_JSON, read_report
from motion.clip_set import MANIFEST
from motion.library import ENDINGS
from motion.npz import read_file
from motion.pipeline import ProcessRequest
from motion.report.record import TRACKABLE


def files_in(folder: Path) -> list[tuple[Path, str]]:
    """The motion files in a folder and those in it, in order, each with a clip's name: its path without ending,
    parts joined by ``_``. Raises InputError where there is none, or two would have the same name."""
    files = sorted(path for path in folder.rglob("*") if path.suffix in ENDINGS and path.is_file())
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


def write_manifest(parent: Path, names: Sequence[str], licence: str) -> tuple[Path, int]:
    """List the trackable results among ``names`` in ``parent``; the file, and how many there are.

    Raises InputError where none is trackable.
    """
    clips = []
    for name in names:
        report, clip = read_report(parent / name / REPORT_JSON), Path(name) / f"{name}.npz"
        if report is not None and report.get("verdict") == TRACKABLE and (parent / clip).is_file():
            sha256 = hashlib.sha256((parent / clip).read_bytes()).hexdigest()
            clips.append({"file": str(clip), "sha256": sha256, **({"licence": licence} if licence else {})})
    if not clips:
        raise InputError("no clip is trackable", where=parent, hint="see the report.html of each")
    path = parent / MANIFEST
    write_whole(path, yaml.safe_dump({"clips": clips}, sort_keys=False, allow_unicode=True).encode())
    return path, len(clips)
