"""Made-up SMPL parameters of a person, and the AMASS and GVHMR files that hold them."""

import io
import pickle
import zipfile
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from tests.motion.human.people import Person

# Our axes (x forward, y left, z up) to SMPL's (x left, y up, z forward), and a pelvis of the neutral mean shapes there.
TO_SMPL = Rotation.from_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]])
PELVIS = {"smplh": np.array([-0.0018, -0.2233, 0.0282]), "smplx": np.array([0.0031, -0.3514, 0.0120])}


def parameters(who: Person, model: str, world: Rotation) -> tuple[np.ndarray, np.ndarray]:
    """poses (N,66) and trans (N,3) of `who` in a world that `world` turns ours into."""
    poses = []
    for local in who.local:
        inner = [(TO_SMPL * turn * TO_SMPL.inv()).as_rotvec() for turn in local[1:]]
        poses.append([(world * local[0] * TO_SMPL.inv()).as_rotvec(), *inner])
    return np.reshape(poses, (len(poses), 66)), world.apply(who.root) - PELVIS[model]


def amass(who: Person, width: int = 156, **changes: Any) -> bytes:
    """An AMASS file, z up; a change to None leaves the field out."""
    poses, trans = parameters(who, "smplx" if width == 165 else "smplh", Rotation.identity())
    fields = {
        "poses": np.pad(poses, ((0, 0), (0, width - 66)), constant_values=0.1),
        "trans": trans,
        "betas": np.zeros(16),
        "gender": np.array("male"),
        "mocap_framerate": np.array(120.0),
        "dmpls": np.zeros((len(trans), 8)),
        "markers": np.array([{"a": 1}], dtype=object),
    } | changes
    buffer = io.BytesIO()
    np.savez(buffer, **{name: value for name, value in fields.items() if value is not None})
    return buffer.getvalue()


def gvhmr_table(who: Person) -> dict[str, np.ndarray]:
    """`smpl_params_global` of a GVHMR result, y up."""
    poses, trans = parameters(who, "smplx", TO_SMPL)
    return {
        "global_orient": poses[:, :3].astype("<f4"),
        "body_pose": poses[:, 3:].astype("<f4"),
        "transl": trans.astype("<f4"),
        "betas": np.zeros((len(trans), 10), "<f4"),
    }


class FloatStorage:
    """Stands for torch.FloatStorage by its name."""


def _rebuild_tensor_v2() -> None:
    """Stands for the function of torch by its name."""


FloatStorage.__module__ = "torch"
_rebuild_tensor_v2.__module__ = "torch._utils"


class _Storage:
    def __init__(self, array: np.ndarray, raw: list[bytes]) -> None:
        self.count, self.number = array.size, len(raw)
        raw.append(np.ascontiguousarray(array).tobytes())


class _Tensor:
    def __init__(self, array: np.ndarray, raw: list[bytes]) -> None:
        strides = tuple(np.cumprod((1, *array.shape[:0:-1]))[::-1].tolist())
        self.state = (_Storage(array, raw), 0, array.shape, strides, False, {})

    def __reduce__(self) -> tuple:
        return _rebuild_tensor_v2, self.state


class _Pickler(pickle._Pickler):  # type: ignore[misc]
    """Names globals without importing them, and storages by persistent ids."""

    def persistent_id(self, value: Any) -> Any:
        if not isinstance(value, _Storage):
            return None
        return ("storage", FloatStorage, str(value.number), "cpu", value.count)

    def save_global(self, value: Any, name: str | None = None) -> None:
        self.write(f"c{value.__module__}\n{value.__name__}\n".encode())
        self.memoize(value)

    dispatch: ClassVar = {**pickle._Pickler.dispatch, type: save_global, type(parameters): save_global}


def torch_bytes(tensors: Mapping[str, Any], prefix: str = "hmr4d_results") -> bytes:
    """What torch.save writes for a dict of (nested dicts of) float tensors, here without torch: a zip of a pickle whose
    persistent ids name raw storages."""
    raw: list[bytes] = []

    def wrapped(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {name: wrapped(item) for name, item in value.items()}
        return _Tensor(value, raw) if isinstance(value, np.ndarray) else value

    stream, buffer = io.BytesIO(), io.BytesIO()
    _Pickler(stream, 2).dump(wrapped(tensors))
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(f"{prefix}/data.pkl", stream.getvalue())
        archive.writestr(f"{prefix}/byteorder", "little")
        for number, content in enumerate(raw):
            archive.writestr(f"{prefix}/data/{number}", content)
        archive.writestr(f"{prefix}/version", "3\n")
    return buffer.getvalue()
