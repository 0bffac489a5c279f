"""The body behind SMPL parameters: from the licensed model files where the user has them, else the mean skeleton."""

import importlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.errors import InputError
from core.rotations import quat_rotate
from motion.human.motion import ANKLES, JOINTS, PARENTS
from motion.human.skeleton import FEET, FROM_SMPL_WXYZ, MEAN_SKELETON, Skeleton

# The pelvis of the neutral mean shapes in SMPL's axes: a translation moves the body about the origin of the mesh.
_PELVIS_M = {"smplx": (0.0031, -0.3514, 0.0120)}
_PELVIS_SMPL_M = (-0.0018, -0.2233, 0.0282)
_NO_MODEL = (
    "No body model files were given: the built-in mean SMPL skeleton and its soles stand in, and the recorded shape "
    "of the body (betas) is not used."
)


@dataclass(frozen=True, eq=False)
class SmplBody:
    """A skeleton, where its pelvis (3,) lies in the axes of SMPL without translation, and a sentence about it."""

    skeleton: Skeleton
    pelvis_m: np.ndarray
    note: str


def body_of(model: str, gender: str, betas: np.ndarray, body_models: Path | None) -> SmplBody:
    """The body of `model` (smpl, smplh, smplx), `gender` and shape `betas` (B,).

    `body_models` is the folder of the licensed files as the smplx package expects it (smplx/SMPLX_NEUTRAL.npz, ...);
    None takes the mean skeleton. Raises InputError when they cannot be read or smplx is not installed.
    """
    if body_models is None:
        return SmplBody(MEAN_SKELETON, np.array(_PELVIS_M.get(model, _PELVIS_SMPL_M)), _NO_MODEL)
    layer = _layer(model, gender, body_models)
    template, directions, regressor = (
        np.asarray(getattr(layer, name).detach().cpu().numpy(), dtype=np.float64)
        for name in ("v_template", "shapedirs", "J_regressor")
    )
    used = min(len(betas), directions.shape[2])
    vertex = template + directions[..., :used] @ betas[:used]
    joint = regressor[: len(JOINTS)] @ vertex
    note = f"The body is the licensed {model} model, {gender}, with {used} shape numbers of the file."
    return SmplBody(_skeleton(_turned(vertex), _turned(joint)), joint[0], note)


def _layer(model: str, gender: str, body_models: Path) -> Any:
    where = "--body-models"
    if not body_models.is_dir():
        raise InputError("no such folder", where=where, got=body_models, expected="the folder of the licensed files")
    try:
        smplx = importlib.import_module("smplx")
    except ImportError as error:
        hint = "install it (pip install smplx), or leave the option out: the mean skeleton stands in"
        raise InputError("the package smplx is not installed", where=where, hint=hint) from error
    try:
        return smplx.create(str(body_models), model_type=model, gender=gender, use_pca=False)
    except Exception as error:  # asserts and more kinds, by version; every one means the same to the user
        got = f"{type(error).__name__}: {error}"
        raise InputError(f"smplx cannot load {model}, {gender}", where=f"{where} {body_models}", got=got) from error


def _turned(points: np.ndarray) -> np.ndarray:
    return quat_rotate(np.broadcast_to(FROM_SMPL_WXYZ, (len(points), 4)), points)


def _skeleton(vertex: np.ndarray, joint: np.ndarray) -> Skeleton:
    """The joints' own offsets; the mean soles at the size of the feet, down to the lowest vertex."""
    offset = joint - joint[list(PARENTS)]
    offset[0] = 0.0
    sizes = [np.linalg.norm(o[list(FEET), :2], axis=1)[:, None, None] for o in (offset, MEAN_SKELETON.offset_m)]
    sole = MEAN_SKELETON.sole_m * sizes[0] / sizes[1]
    sole[..., 2] = vertex[:, 2].min() - joint[list(ANKLES), 2][:, None]
    return Skeleton(offset, sole)
