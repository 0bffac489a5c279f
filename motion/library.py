"""Finds a clip: one of those bundled by name, or any file in a known format."""

from pathlib import Path

from motion.clip import Clip, clip_from_bytes
from motion.importers.csv29 import DEFAULT_FPS, read_csv29
from motion.importers.pbhc_pkl import read_pbhc
from motion.npz import read_file
from motion.reference import joint_columns
from robot.errors import InputError
from robot.robot import Robot

CLIPS = Path(__file__).resolve().parent / "clips"
FORMATS = "kata clip (.npz), PBHC motion (.pkl) or 29-joint CSV"
_ENDINGS = (".npz", ".pkl", ".csv")


def bundled_names() -> tuple[str, ...]:
    """Names of the clips that come with kata."""
    return tuple(sorted(path.stem for path in CLIPS.glob("*.npz")))


def open_motion(name_or_file: str | Path, robot: Robot, *, csv_fps: float = DEFAULT_FPS) -> Clip:
    """The bundled clip of that name, or the motion in that file: a kata clip, a PBHC .pkl or a 29-joint CSV.

    The format is told by the content. The clip's joints are those of `robot`, in whatever order. `csv_fps` is the frame
    rate of a CSV, which does not say. Raises InputError: no such clip or file, unknown format, damaged, other joints.
    """
    path = _find(name_or_file)
    content = read_file(path)
    if not content:
        raise InputError("empty file", where=path, expected=FORMATS)
    if content[:2] == b"PK":
        clip = clip_from_bytes(content, where=str(path))
    elif content[:1] == b"\x80" or path.suffix == ".pkl":
        clip = read_pbhc(content, where=str(path))
    elif path.suffix == ".npz" or b"\0" in content:
        raise InputError("unknown or damaged format", where=path, expected=FORMATS)
    else:
        clip = read_csv29(content, str(path), robot, csv_fps)
    joint_columns(clip, robot, where=str(path))
    return clip


def _find(name_or_file: str | Path) -> Path:
    """A name without folder and ending is a bundled clip unless only a file of that name exists."""
    text = str(name_or_file)
    path = Path(text)
    if text in bundled_names():
        return CLIPS / f"{text}.npz"
    if not text or "\0" in text:
        raise InputError("no motion given", got=repr(text), expected=f"one of {_bundled_list()}, or a file: {FORMATS}")
    if path.suffix not in _ENDINGS and path.name == text and not path.exists():
        raise InputError("no such clip", where=text, expected=f"one of {_bundled_list()}, or a file: {FORMATS}")
    return path


def _bundled_list() -> str:
    return ", ".join(bundled_names())
