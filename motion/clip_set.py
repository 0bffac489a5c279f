"""Several clips under their names: a folder of them, or a manifest that says more."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from core.config import errors_in, load_options
from core.errors import InputError
from core.structured import distinct
from motion.clip import Clip
from motion.formats import HUMAN_FORMATS, format_of
from motion.library import bundled_names, open_motion
from motion.npz import read_file
from motion.read import read_clip
from robot.robot import Robot

Split = Literal["train", "test"]
MANIFEST = "clips.yaml"  # of a folder of clips
MANIFEST_ENDINGS = (".yaml", ".yml")
CLIP_ENDINGS = (".npz", ".pkl", ".csv")


@dataclass(frozen=True)
class Entry:
    """One clip of a manifest.

    ``file``: from the manifest's folder on, or an absolute path. ``sha256``: of the file, in hex; None: unchecked.
    ``licence``: under which its motion may be used. ``labels``: words for what is done. ``fps``: frame rate of a CSV,
    which does not say.
    """

    file: str
    sha256: str | None = None
    licence: str = ""
    labels: tuple[str, ...] = ()
    split: Split = "train"
    fps: float | None = None

    @property
    def name(self) -> str:
        """The file's name without ending."""
        return Path(self.file).stem


@dataclass(frozen=True)
class Manifest:
    """The document: a list of clips."""

    clips: tuple[Entry, ...]

    def __post_init__(self) -> None:
        if not self.clips:
            raise InputError("no clip", where="clips", expected="one or more")
        distinct("clips", [entry.name for entry in self.clips], "two clips of the same name")


@dataclass(frozen=True)
class NamedClip:
    """A clip, and what its set calls it."""

    name: str
    clip: Clip


def open_clips(motions: Sequence[str], robot: Robot) -> tuple[NamedClip, ...]:
    """Clips by names, in files, in folders and in manifests, in that order.

    Raises:
        InputError: one is none, or two have the same name, so that nobody could tell which is meant.
    """
    clips: list[NamedClip] = []
    for motion in motions:
        is_set = Path(motion).is_dir() or Path(motion).suffix in MANIFEST_ENDINGS
        is_set = is_set and motion not in bundled_names()  # a folder of such a name is ./NAME
        found = open_clip_set(motion, robot) if is_set else (NamedClip(Path(motion).stem, open_motion(motion, robot)),)
        clips += found
    distinct("--motion", [clip.name for clip in clips], "two clips of the same name")
    return tuple(clips)


def open_clip_set(folder_or_manifest: str | Path, robot: Robot, split: Split = "train") -> tuple[NamedClip, ...]:
    """The clips of ``split`` in a manifest, in a folder's manifest ``clips.yaml``, or all of a folder without one; in
    the order of their names.

    Raises:
        InputError: naming file and field: no such folder or manifest, no clip in it, two of the same name, a clip that
            is none of the robot's, a file that is not the one that the manifest means.
    """
    path = Path(folder_or_manifest)
    if (path / MANIFEST).is_file():
        path = path / MANIFEST
    if path.is_dir():
        return _of_folder(path, robot)
    if path.suffix not in MANIFEST_ENDINGS:
        raise InputError("no such clip set", where=path, expected="a folder of clips, or a manifest (.yaml)")
    entries = [entry for entry in load_options(Manifest, path).clips if entry.split == split]
    if not entries:
        raise InputError("no clip", where=path, expected=f"one or more of split {split}")
    return tuple(_opened(path, entry, robot) for entry in sorted(entries, key=lambda entry: entry.name))


def _of_folder(folder: Path, robot: Robot) -> tuple[NamedClip, ...]:
    clips = (file for file in folder.iterdir() if file.suffix.lower() in CLIP_ENDINGS and file.name[0] != ".")
    files = sorted(clips, key=lambda file: file.stem)
    if not files:
        raise InputError(
            "no clip", where=folder, expected=f"{MANIFEST}, or files that end in {', '.join(CLIP_ENDINGS)}"
        )
    with errors_in(folder):
        distinct(None, [file.stem for file in files], "two clips of the same name")
    return tuple(NamedClip(file.stem, open_motion(file, robot)) for file in files)


def _opened(manifest: Path, entry: Entry, robot: Robot) -> NamedClip:
    path = manifest.parent / entry.file
    where = f"{manifest}: clips[{entry.name}]"
    content = read_file(path)
    found = hashlib.sha256(content).hexdigest()
    if entry.sha256 is not None and found != entry.sha256.lower():
        raise InputError("another file", where=f"{where}.sha256", got=found, expected=entry.sha256)
    kind = format_of(content, path)
    if kind in HUMAN_FORMATS:
        hint = f"retarget it first: motion/process --input {path}"
        raise InputError("is a human's motion", where=f"{where}.file", got=kind.value, expected="a robot's", hint=hint)
    clip = read_clip(content, kind, str(path), robot, entry.fps)
    return NamedClip(entry.name, replace(clip, license=entry.licence or clip.license))
