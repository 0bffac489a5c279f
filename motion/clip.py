"""The motion clip: what one file holds, checked strictly, saved atomically and with the same bytes every time."""

import hashlib
import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from core.config import errors_in
from core.errors import InputError
from core.files import write_whole
from core.structured import parse
from motion.npz import read_file, read_npz
from world.scene import FLAT, MAX_BOXES, Scene

ARRAY_FIELDS = ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact")
TEXT_FIELDS = ("source", "license", "created_by")
FIELDS = ("fps", "joint_names", *ARRAY_FIELDS, *TEXT_FIELDS)
SCENE_FIELD = "scene"  # only in files of clips that do not stand on flat ground at 0

MIN_FPS, MAX_FPS = 1.0, 1000.0
MAX_ROOT_M = 1e3  # beyond: surely not metres
MAX_JOINT_RAD = 4.0 * np.pi  # beyond: surely not radians
QUAT_TOLERANCE = 1e-4
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, eq=False)
class Clip:
    """N frames of a robot's root and J joints at `fps` frames per second; lasts (N-1)/fps seconds.

    root_pos_w (N,3) m; root_quat_wxyz (N,4) unit; joint_pos_rad (N,J) in the order of joint_names;
    contact (N,2) left and right foot in [0,1]; scene: what the motion stands in. Arrays become read-only float64.
    Raises InputError naming the field.
    """

    fps: float
    joint_names: tuple[str, ...]
    root_pos_w: np.ndarray
    root_quat_wxyz: np.ndarray
    joint_pos_rad: np.ndarray
    contact: np.ndarray
    source: str = ""
    license: str = ""
    created_by: str = ""
    scene: Scene = FLAT

    def __post_init__(self) -> None:
        object.__setattr__(self, "fps", _checked_fps(self.fps))
        object.__setattr__(self, "joint_names", _checked_names(self.joint_names))
        num_joints = len(self.joint_names)
        widths = {"root_pos_w": 3, "root_quat_wxyz": 4, "joint_pos_rad": num_joints, "contact": 2}
        for name, width in widths.items():
            object.__setattr__(self, name, _checked_array(name, getattr(self, name), width))
        for name in TEXT_FIELDS:
            if not isinstance(getattr(self, name), str):
                raise InputError("wrong type", where=name, got=type(getattr(self, name)).__name__, expected="text")
        lengths = {name: len(getattr(self, name)) for name in ARRAY_FIELDS}
        if len(set(lengths.values())) > 1:
            raise InputError("numbers of frames differ", got=_listed(lengths), expected="one number of frames")
        _check_ranges(self)

    @property
    def num_frames(self) -> int:
        """N."""
        return len(self.root_pos_w)

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.joint_names)

    @property
    def duration_s(self) -> float:
        """(N-1)/fps."""
        return (self.num_frames - 1) / self.fps

    @cached_property
    def sha256(self) -> str:
        """Digest of the motion itself (fps, joint names, arrays, scene); the texts about it do not enter."""
        digest = hashlib.sha256()
        digest.update(np.float64(self.fps).astype("<f8").tobytes())
        digest.update("\n".join(self.joint_names).encode())
        for name in ARRAY_FIELDS:
            array = getattr(self, name)
            digest.update(f"|{name}{array.shape}|".encode())
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        if self.scene != FLAT:
            digest.update(b"|scene|" + _scene_numbers(self.scene).tobytes())
        return digest.hexdigest()


def load_clip(path: str | Path) -> Clip:
    """Clip of the .npz file at `path`. Raises InputError naming the file and the field."""
    return clip_from_bytes(read_file(path), where=str(path))


def save_clip(clip: Clip, path: str | Path) -> None:
    """Write `clip` as .npz; the file is complete or not there. Raises InputError when it cannot be written."""
    path = Path(path)
    if path.suffix != ".npz":
        raise InputError("wrong file name", where=path, got=path.suffix or "no ending", expected="a name in .npz")
    content = clip_to_bytes(clip)
    try:
        write_whole(path, content)
    except OSError as error:
        raise InputError("cannot be written", where=path, got=error.strerror or str(error)) from error


def clip_to_bytes(clip: Clip) -> bytes:
    """The .npz file of `clip` as bytes; equal clips give equal bytes (stored, not compressed, one fixed date)."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        arrays = {name: np.asarray(getattr(clip, name)) for name in FIELDS}
        if clip.scene != FLAT:
            arrays[SCENE_FIELD] = _scene_numbers(clip.scene)
        for name, value in arrays.items():
            array = value.astype("<f8") if name in ("fps", *ARRAY_FIELDS) else value
            member = io.BytesIO()
            np.lib.format.write_array(member, np.ascontiguousarray(array).reshape(array.shape), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", _ZIP_TIME), member.getvalue())
    return buffer.getvalue()


def clip_from_bytes(content: bytes, where: str = "clip") -> Clip:
    """Inverse of clip_to_bytes; reads any .npz with these fields; a scene may lack. Raises InputError (file, field)."""
    arrays = read_npz(content, where)
    unknown, missing = sorted(arrays.keys() - {*FIELDS, SCENE_FIELD}), [name for name in FIELDS if name not in arrays]
    if unknown or missing:
        got = "; ".join(f"{kind} {', '.join(n)}" for kind, n in (("unknown", unknown), ("missing", missing)) if n)
        raise InputError("wrong fields", where=where, got=got, expected=", ".join(FIELDS))
    with errors_in(where):
        return Clip(**_plain_values(arrays))


def _plain_values(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Arrays as they came from the file -> arguments of Clip."""
    values: dict[str, Any] = {name: arrays[name] for name in ARRAY_FIELDS}
    for name in ("fps", *TEXT_FIELDS):
        kinds, what = ("fiu", "one number") if name == "fps" else ("U", "one text")
        if arrays[name].ndim or arrays[name].dtype.kind not in kinds:
            got = f"shape {arrays[name].shape}, type {arrays[name].dtype}"
            raise InputError("wrong shape or type", where=name, got=got, expected=what)
        values[name] = arrays[name].item()
    if arrays["joint_names"].ndim != 1 or arrays["joint_names"].dtype.kind != "U":
        got = f"shape {arrays['joint_names'].shape}, type {arrays['joint_names'].dtype}"
        raise InputError("wrong shape or type", where="joint_names", got=got, expected="a list of texts")
    values["joint_names"] = tuple(arrays["joint_names"].tolist())
    if SCENE_FIELD in arrays:
        values[SCENE_FIELD] = _scene_of(arrays[SCENE_FIELD])
    return values


def _scene_numbers(scene: Scene) -> np.ndarray:
    """The floor's height, then centre, half sizes and yaw of each box: (1 + 7K,)."""
    boxes = [number for box in scene.boxes for number in (*box.centre_m, *box.half_size_m, box.yaw_rad)]
    return np.array([scene.floor_m, *boxes], dtype="<f8")


def _scene_of(numbers: np.ndarray) -> Scene:
    """Inverse of _scene_numbers."""
    fits = numbers.ndim == 1 and numbers.size % 7 == 1 and numbers.size <= 1 + 7 * MAX_BOXES
    if not fits or numbers.dtype.kind not in "fiu":
        got = f"shape {numbers.shape}, type {numbers.dtype}"
        raise InputError(
            "wrong shape or type",
            where=SCENE_FIELD,
            got=got,
            expected=f"1 number, and 7 a box, at most {MAX_BOXES} boxes",
        )
    floor_m, *rest = numbers.tolist()
    rows = [rest[i : i + 7] for i in range(0, len(rest), 7)]
    boxes = [{"centre_m": row[:3], "half_size_m": row[3:6], "yaw_rad": row[6]} for row in rows]
    return parse(Scene, {"floor_m": floor_m, "boxes": boxes}, SCENE_FIELD)


def _checked_fps(fps: Any) -> float:
    if isinstance(fps, bool) or not isinstance(fps, int | float | np.integer | np.floating):
        raise InputError("wrong type", where="fps", got=type(fps).__name__, expected="a number")
    if not MIN_FPS <= fps <= MAX_FPS:
        raise InputError("out of range", where="fps", got=fps, expected=f"{MIN_FPS:g} to {MAX_FPS:g} frames per second")
    return float(fps)


def _checked_names(names: Any) -> tuple[str, ...]:
    names = tuple(names)
    if not names or not all(isinstance(name, str) and name.strip() for name in names):
        raise InputError("wrong value", where="joint_names", got=list(names), expected="names of one or more joints")
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError("duplicate joints", where="joint_names", got=", ".join(repeated), expected="each joint once")
    return tuple(str(name) for name in names)


def _checked_array(name: str, value: Any, width: int) -> np.ndarray:
    """Read-only float64 (N, width), N >= 2, finite."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise InputError("wrong type", where=name, got=f"type {array.dtype}", expected="numbers")
    if array.ndim != 2 or array.shape[1] != width or len(array) < 2:
        raise InputError("wrong shape", where=name, got=array.shape, expected=f"(N, {width}) with N of 2 or more")
    array = np.array(array, dtype=np.float64, order="C")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        frame, column = bad[0]
        got = f"{array[frame, column]} in column {column}"
        raise InputError("not finite", where=f"{name}: frame {frame}", got=got, expected="finite numbers")
    array.setflags(write=False)
    return array


def _check_ranges(clip: Clip) -> None:
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(clip.root_quat_wxyz, axis=1)
    checks = (
        ("root_quat_wxyz", np.abs(norms - 1.0) <= QUAT_TOLERANCE, "unit quaternions in order w, x, y, z"),
        ("contact", ((clip.contact >= 0.0) & (clip.contact <= 1.0)).all(axis=1), "values from 0 to 1"),
        ("root_pos_w", (np.abs(clip.root_pos_w) <= MAX_ROOT_M).all(axis=1), f"metres, at most {MAX_ROOT_M:g}"),
        ("joint_pos_rad", (np.abs(clip.joint_pos_rad) <= MAX_JOINT_RAD).all(axis=1), "radians, at most 4 pi"),
    )
    for name, good, expected in checks:
        bad = np.flatnonzero(~good)
        if bad.size:
            got = _row_text(getattr(clip, name)[bad[0]])
            raise InputError("out of range", where=f"{name}: frame {bad[0]}", got=got, expected=expected)


def _row_text(row: np.ndarray) -> str:
    return "[" + ", ".join(f"{x:.5g}" for x in row) + "]"


def _listed(lengths: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {length}" for name, length in lengths.items())
