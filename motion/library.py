"""Finds a clip: one of those bundled by name, or any file in a known format."""

from pathlib import Path

from core.errors import InputError
from motion.clip import Clip
from motion.formats import FORMATS, HUMAN_FORMATS, format_of
from motion.npz import read_file
from motion.read import read_clip
from robot.robot import Robot

CLIPS = Path(__file__).resolve().parent / "clips"
ENDINGS = (".npz", ".pkl", ".csv", ".bvh", ".pt")


def bundled_names() -> tuple[str, ...]:
    """Names of the clips that come with kata."""
    return tuple(sorted(path.stem for path in CLIPS.glob("*.npz")))


def open_motion(name_or_file: str | Path, robot: Robot, *, csv_fps: float | None = None) -> Clip:
    """The bundled clip of that name, or the robot's motion in that file, its format told by the content.

    The clip's joints are those of `robot`, in whatever order. `csv_fps` is the frame rate of a CSV, which does not say;
    it counts more than what another file says.
    Raises InputError: no such clip or file, unknown format, damaged, other joints, or the motion of a human.
    """
    path = _find(name_or_file)
    content = read_file(path)
    kind = format_of(content, path)
    if kind in HUMAN_FORMATS:
        hint = f"retarget it first: motion/process --input {path}"
        raise InputError("is a human's motion", where=path, got=kind.value, expected="a motion of the robot", hint=hint)
    return read_clip(content, kind, str(path), robot, csv_fps)


def _find(name_or_file: str | Path) -> Path:
    """A name without folder and ending is a bundled clip unless only a file of that name exists."""
    text = str(name_or_file)
    path = Path(text)
    if text in bundled_names():
        return CLIPS / f"{text}.npz"
    if not text or "\0" in text:
        raise InputError("no motion given", got=repr(text), expected=f"one of {_bundled_list()}, or a file: {FORMATS}")
    if path.suffix.lower() not in ENDINGS and path.name == text and not path.exists():
        raise InputError("no such clip", where=text, expected=f"one of {_bundled_list()}, or a file: {FORMATS}")
    return path


def _bundled_list() -> str:
    return ", ".join(bundled_names())
