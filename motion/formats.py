"""What kind of motion a file holds, told by its content."""

from enum import Enum
from pathlib import Path

from core.errors import InputError
from motion.npz import zip_names

FORMATS = (
    "kata clip (.npz), AMASS (.npz), mjlab or BeyondMimic motion (.npz), GVHMR result (.pt), PBHC motion (.pkl), BVH, "
    "29- or 23-joint CSV"
)
_TORCH_BEFORE_ZIP = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19"  # the number that torch before 1.6 begins files with


class Format(Enum):
    """A known kind of motion file."""

    CLIP = "kata clip"
    MJLAB = "mjlab or BeyondMimic motion"
    PBHC = "PBHC motion"
    CSV = "CSV of robot joints"
    AMASS = "AMASS motion"
    GVHMR = "GVHMR result"
    BVH = "BVH"


HUMAN_FORMATS = frozenset({Format.AMASS, Format.GVHMR, Format.BVH})


def format_of(content: bytes, path: Path) -> Format:
    """The format of a file of that `content`; of its name only the ending .pkl counts. Raises InputError naming it."""
    if not content:
        raise InputError("empty file", where=path, expected=FORMATS)
    if content[:2] == b"PK":
        return _format_of_zip(content, path)
    if content.startswith(_TORCH_BEFORE_ZIP):
        hint = "load it with torch and save it again: torch.save writes zip files since version 1.6"
        raise InputError("torch file of the old kind", where=path, hint=hint)
    if content[:1] == b"\x80" or path.suffix.lower() == ".pkl":
        return Format.PBHC
    if b"\0" in content or path.suffix.lower() in (".npz", ".pt"):
        raise InputError("unknown or damaged format", where=path, expected=FORMATS)
    start = content[:200].removeprefix(b"\xef\xbb\xbf").split(maxsplit=1)
    if path.suffix.lower() == ".bvh" or (start and start[0].upper() == b"HIERARCHY"):
        return Format.BVH
    return Format.CSV


def _format_of_zip(content: bytes, path: Path) -> Format:
    names = zip_names(content, str(path))
    fields = {name.removesuffix(".npy") for name in names}
    if {"poses", "trans"} <= fields:
        return Format.AMASS
    if {"joint_pos", "body_pos_w"} <= fields:
        return Format.MJLAB
    if any(name.rpartition("/")[2] == "data.pkl" for name in names):
        return Format.GVHMR
    if any(name.endswith(".npy") for name in names):
        return Format.CLIP
    raise InputError("unknown archive", where=path, got=", ".join(names[:4])[:100], expected=FORMATS)
