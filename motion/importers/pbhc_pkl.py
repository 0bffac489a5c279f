"""Reference motions in the format of PBHC (and ASAP): a joblib pickle of one motion for the 23-joint G1."""

from pathlib import Path
from typing import Any

import numpy as np

from core.config import errors_in
from core.errors import InputError
from motion.clip import Clip
from motion.importers.g1_joints import JOINTS_23
from motion.importers.pickle_data import read_data_pickle

JOINT_NAMES = JOINTS_23
_WIDTHS = {"root_trans_offset": 3, "root_rot": 4, "dof": len(JOINT_NAMES), "contact_mask": 2}


def read_pbhc(content: bytes, where: str) -> Clip:
    """Clip of a PBHC pickle given as bytes; `where` is the file's path; its last part becomes the source.

    `root_rot` is xyzw, `dof` in the order of JOINT_NAMES (the authors' config), `contact_mask` left, right. The
    top-level key is a path on somebody's machine and is not kept. Raises InputError naming `where` and the field.
    """
    fields = _single_motion(read_data_pickle(content, where), where)
    arrays = {name: _array(fields, name, width, where) for name, width in _WIDTHS.items()}
    fps: Any = fields["fps"]
    if isinstance(fps, np.ndarray) and fps.size == 1:
        fps = fps.item()
    with errors_in(where):
        return Clip(
            fps=fps,
            joint_names=JOINT_NAMES,
            root_pos_w=arrays["root_trans_offset"],
            root_quat_wxyz=wxyz_of_xyzw(arrays["root_rot"]),
            joint_pos_rad=arrays["dof"],
            contact=arrays["contact_mask"],
            source=Path(where).name,
            license="not stated in the file",
            created_by="kata, from a PBHC pickle",
        )


def wxyz_of_xyzw(quat_xyzw: np.ndarray) -> np.ndarray:
    """Unit quaternions (N,4) in our order; a norm off by up to 1 % is rounding and is mended."""
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quat_xyzw, axis=1, keepdims=True)
    unit = quat_xyzw / np.where(np.abs(norm - 1.0) < 0.01, norm, 1.0)
    return unit[:, [3, 0, 1, 2]]


def _single_motion(content: Any, where: str) -> dict[str, Any]:
    """The dict with the fields, alone or under one key of any name."""
    if isinstance(content, dict) and "dof" not in content and len(content) == 1:
        content = next(iter(content.values()))
    if not isinstance(content, dict) or "dof" not in content:
        got = f"{len(content)} entries" if isinstance(content, dict | list | tuple) else type(content).__name__
        raise InputError("no PBHC motion", where=where, got=got, expected="one motion with root_trans_offset, dof, ...")
    missing = [name for name in (*_WIDTHS, "fps") if name not in content]
    if missing:
        expected = ", ".join((*_WIDTHS, "fps"))
        raise InputError("missing fields", where=where, got=f"no {', '.join(missing)}", expected=expected)
    return content


def _array(fields: dict[str, Any], name: str, width: int, where: str) -> np.ndarray:
    """Field `name` as float64 (N, width); a trailing axis of length one is dropped."""
    value = fields[name]
    got = value.shape if isinstance(value, np.ndarray) else type(value).__name__
    if isinstance(value, np.ndarray) and value.ndim == 3 and value.shape[2] == 1:
        value = value[:, :, 0]
    if not isinstance(value, np.ndarray) or value.ndim != 2 or value.shape[1] != width:
        raise InputError("wrong shape or type", where=f"{where}: {name}", got=got, expected=f"array (N, {width})")
    return value.astype(np.float64)
