"""Recordings as SMPL, SMPL-H or SMPL-X parameters: AMASS files and GVHMR results."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from core.errors import InputError
from core.rotations import quat_conjugate, quat_from_rotvec, quat_mul, quat_rotate
from motion.frames import MAX_FRAMES, check_frames, choose_fps
from motion.human.body_model import body_of
from motion.human.motion import ANKLES, JOINTS
from motion.human.placing import FileMotion
from motion.human.skeleton import FEET, FROM_SMPL_WXYZ, posed

RATES = ("mocap_framerate", "mocap_frame_rate")
AMASS_FIELDS = frozenset({"poses", "trans", "betas", "gender", "surface_model_type", *RATES})
GVHMR_FPS = 30.0  # GVHMR brings every video to this rate before it estimates, and does not say so in its result
MAX_WIDTH = 300  # numbers a frame
MAX_ROTATION_RAD = 4.0 * np.pi  # beyond: surely not radians
_BODY = 3 * len(JOINTS)
_MODEL_OF_WIDTH = {72: "smpl", 156: "smplh", 165: "smplx"}


@dataclass(frozen=True, eq=False)
class SmplParameters:
    """N frames as the file has them: rotvec_rad (N,22,3) of the pelvis and the body's joints in SMPL's axes, trans_m
    (N,3), betas (B,); `model` smpl, smplh or smplx; `kind` of the file and the axis that is usually up in it."""

    rotvec_rad: np.ndarray
    trans_m: np.ndarray
    betas: np.ndarray
    model: str
    gender: str
    kind: str
    usual_up: str
    fps: float
    fps_note: str


def read_amass(arrays: Mapping[str, np.ndarray], where: str, fps: float | None) -> SmplParameters:
    """Parameters of an AMASS .npz, SMPL-H or SMPL-X; `fps` counts more than the file's own.

    Raises InputError naming `where` and the field.
    """
    poses = _numbers(arrays, "poses", where)
    model = _text(arrays, "surface_model_type")
    if model not in _MODEL_OF_WIDTH.values():  # none, or a variant's name such as smplx_locked_head
        model = _MODEL_OF_WIDTH.get(poses.shape[1], "smpl")
    stated = None
    for name in (name for name in RATES if name in arrays):
        if arrays[name].size != 1 or arrays[name].dtype.kind not in "fiu":
            raise InputError("not one number", where=f"{where}: {name}", got=f"shape {arrays[name].shape}")
        stated = float(arrays[name].reshape(()))
    rate, fps_note = choose_fps(fps, stated, where)
    return SmplParameters(
        rotvec_rad=_rotations(poses, f"{where}: poses"),
        trans_m=_translations(_numbers(arrays, "trans", where), len(poses), f"{where}: trans"),
        betas=_betas(arrays.get("betas"), where),
        model=model,
        gender=_text(arrays, "gender") or "neutral",
        kind="AMASS files",
        usual_up="z",
        fps=rate,
        fps_note=fps_note,
    )


def read_gvhmr(content: Any, where: str, fps: float | None) -> SmplParameters:
    """Parameters of a GVHMR result (hmr4d_results.pt as read_torch gives it): its `smpl_params_global`, SMPL-X.

    `fps` counts more than GVHMR's 30. Raises InputError naming `where` and the field.
    """
    table = content.get("smpl_params_global", content) if isinstance(content, dict) else None
    if not isinstance(table, dict) or "body_pose" not in table:
        expected = "a GVHMR result with smpl_params_global: body_pose, global_orient, transl, betas"
        raise InputError("no SMPL parameters", where=where, expected=expected)
    where = f"{where}: smpl_params_global"
    orient, body = _numbers(table, "global_orient", where), _numbers(table, "body_pose", where)
    if orient.shape != (len(body), 3):
        raise InputError("wrong shape", where=f"{where}: global_orient", got=orient.shape, expected=(len(body), 3))
    note = f"{GVHMR_FPS:g} frames per second assumed: GVHMR brings videos to that rate, and its results do not say."
    rate, fps_note = choose_fps(fps, None, where) if fps is not None else (GVHMR_FPS, note)
    return SmplParameters(
        rotvec_rad=_rotations(np.hstack([orient, body]), f"{where}: body_pose"),
        trans_m=_translations(_numbers(table, "transl", where), len(body), f"{where}: transl"),
        betas=_betas(table.get("betas"), where),
        model="smplx",
        gender="neutral",
        kind="GVHMR results",
        usual_up="y",
        fps=rate,
        fps_note=fps_note,
    )


def smpl_motion(parameters: SmplParameters, body_models: Path | None) -> FileMotion:
    """The motion that the parameters describe; without `body_models` of the mean skeleton, as the notes say.

    Raises InputError when the body models cannot be read.
    """
    body = body_of(parameters.model, parameters.gender, parameters.betas, body_models)
    # A turn about axes that are renamed is the same turn: below the pelvis everything is local to the body.
    axes = np.broadcast_to(FROM_SMPL_WXYZ, (*parameters.rotvec_rad.shape[:2], 4))
    local = quat_from_rotvec(quat_rotate(axes, parameters.rotvec_rad))
    local[:, 0] = quat_mul(quat_from_rotvec(parameters.rotvec_rad[:, 0]), quat_conjugate(axes[:, 0]))
    pos_m, quat_wxyz = posed(body.skeleton, parameters.trans_m + body.pelvis_m, local)
    t_pose_m = body.skeleton.t_pose_m()
    return FileMotion(
        fps=parameters.fps,
        pos_m=pos_m,
        quat_wxyz=quat_wxyz,
        sole_m=body.skeleton.sole_m,
        foot_m=t_pose_m[list(FEET)] - t_pose_m[list(ANKLES)],
        kind=parameters.kind,
        usual_up=parameters.usual_up,
        notes=(f"Read as {parameters.model} parameters of {parameters.kind}.", parameters.fps_note, body.note),
    )


def _numbers(table: Mapping[str, Any], name: str, where: str) -> np.ndarray:
    """Field `name` (N, ...) of N frames, finite numbers; converted only once its size is known to be sane."""
    array = table.get(name)
    numbers = isinstance(array, np.ndarray) and array.dtype.kind in "fiu" and array.ndim == 2
    if array is None or not numbers or array.shape[1] > MAX_WIDTH:
        got = "nothing" if array is None else f"shape {getattr(array, 'shape', 'none')}"
        raise InputError("wrong shape or type", where=f"{where}: {name}", got=got, expected="numbers (N, ...)")
    check_frames(len(array), f"{where}: {name}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        raise InputError("not finite", where=f"{where}: {name}: frame {bad[0, 0]}", expected="finite numbers")
    return array.astype(np.float64)


def _rotations(poses: np.ndarray, where: str) -> np.ndarray:
    """Axis times angle (N,22,3) of the body's joints, the first of `poses`."""
    if poses.shape[1] < _BODY or poses.shape[1] % 3:
        expected = f"(N, {_BODY}) or wider, three numbers a joint"
        raise InputError("wrong shape", where=where, got=poses.shape, expected=expected)
    rotvec = poses[:, :_BODY].reshape(len(poses), len(JOINTS), 3)
    part = np.abs(rotvec).max(axis=-1)
    if part.max() > MAX_ROTATION_RAD:
        frame, joint = np.unravel_index(part.argmax(), part.shape)
        got = f"{part.max():.5g} at {JOINTS[joint]}"
        hint = "are these degrees?"
        raise InputError("out of range", where=f"{where}: frame {frame}", got=got, expected="radians", hint=hint)
    return rotvec


def _translations(trans: np.ndarray, count: int, where: str) -> np.ndarray:
    if trans.shape != (count, 3):
        raise InputError("wrong shape", where=where, got=trans.shape, expected=(count, 3))
    return trans


def _betas(value: Any, where: str) -> np.ndarray:
    """Shape numbers (B,), of many frames their mean; none where the file has none."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu" or not value.size:
        return np.zeros(0)
    if value.ndim not in (1, 2) or value.shape[-1] > MAX_WIDTH or len(value) > MAX_FRAMES:
        raise InputError("wrong shape", where=f"{where}: betas", got=value.shape, expected="(B,) or (N, B)")
    if not np.isfinite(value).all():
        raise InputError("not finite", where=f"{where}: betas", expected="finite numbers")
    return np.asarray(value.reshape(-1, value.shape[-1]).mean(axis=0), dtype=np.float64)


def _text(arrays: Mapping[str, np.ndarray], name: str) -> str:
    """A text of the file in lower case, however it was stored; empty where it has none."""
    value = arrays.get(name)
    if value is None or value.size != 1 or value.dtype.kind not in "US":
        return ""
    text = value.reshape(()).item()
    return (text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)).strip().lower()
