"""The actor contract inside an ONNX file: one JSON document, the reference motion, and flat community keys.

Writing needs the ``onnx`` package (a training extra); reading needs onnxruntime alone.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import onnxruntime

from core.config import errors_in
from core.errors import InputError
from core.files import write_whole
from policy.session import open_session
from policy.spec import ActorSpec
from policy.spec_json import spec_from_json, spec_to_json

SPEC_KEY = "actor_spec"
MOTION_KEY = "motion_npz"
MOTION_SHA256_KEY = "motion_npz_sha256"


@dataclass(frozen=True)
class ActorMetadata:
    """What ``write_metadata`` stored."""

    spec: ActorSpec
    motion_npz: bytes | None


def write_metadata(onnx_path: str | Path, spec: ActorSpec, motion_npz: bytes | None = None) -> None:
    """Store ``spec`` and the reference clip's ``.npz`` bytes in the ONNX file, replacing it atomically.

    Metadata under other keys stays. Weights kept beside the file are taken into it. InputError when the
    file cannot be read, when there is a clip but ``spec.motion`` says nothing of it, and without ``onnx``.
    """
    path = Path(onnx_path)
    if motion_npz is not None and spec.motion is None:
        raise InputError("a clip without its description", where=path, expected="spec.motion beside motion_npz")
    entries = {SPEC_KEY: spec_to_json(spec)} | community_keys(spec)
    if motion_npz is not None:
        entries[MOTION_KEY] = base64.b64encode(motion_npz).decode("ascii")
        entries[MOTION_SHA256_KEY] = hashlib.sha256(motion_npz).hexdigest()
    _replace_entries(path, entries)


def read_metadata(onnx_path: str | Path) -> ActorMetadata:
    """Inverse of ``write_metadata``. InputError for an unreadable file or unusable metadata."""
    path = Path(onnx_path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path) from error
    return parse_metadata(metadata_map(open_session(content, path)), path)


def metadata_map(session: onnxruntime.InferenceSession) -> dict[str, str]:
    """All metadata of an open model."""
    return dict(session.get_modelmeta().custom_metadata_map)


def parse_metadata(entries: Mapping[str, str], where: str | Path) -> ActorMetadata:
    """Read the entries of a model's metadata. InputError, beginning with ``where``, if unusable."""
    if SPEC_KEY not in entries:
        got = ", ".join(sorted(entries)) or "no metadata"
        raise InputError("not an actor of this project", where=where, got=got, expected=f"metadata {SPEC_KEY!r}")
    with errors_in(where):
        return ActorMetadata(spec_from_json(entries[SPEC_KEY]), _motion_bytes(entries))


def community_keys(spec: ActorSpec) -> dict[str, str]:
    """The flat keys that G1 deployment code of the mjlab kind reads: comma-separated, here unrounded."""
    terms = dict.fromkeys(entry.term for group in spec.observations for entry in group.terms)
    return {
        "joint_names": ",".join(spec.joint_names),
        "joint_stiffness": _numbers(spec.kp),
        "joint_damping": _numbers(spec.kd),
        "default_joint_pos": _numbers(spec.default_pos_rad),
        "action_scale": _numbers(spec.action_scale),
        "observation_names": ",".join(terms),
        "command_names": "motion",
    }


def _numbers(values: Iterable[float]) -> str:
    return ",".join(repr(float(value)) for value in values)


def _motion_bytes(entries: Mapping[str, str]) -> bytes | None:
    if MOTION_KEY not in entries:
        return None
    try:
        content = base64.b64decode(entries[MOTION_KEY], validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError(f"not base64 ({error})", where=MOTION_KEY) from error
    sha256 = hashlib.sha256(content).hexdigest()
    if sha256 != entries.get(MOTION_SHA256_KEY):
        raise InputError(
            "the embedded motion is damaged: its SHA-256 differs from the recorded one",
            where=MOTION_KEY,
            got=sha256,
            expected=entries.get(MOTION_SHA256_KEY, f"metadata {MOTION_SHA256_KEY!r}"),
        )
    return content


def _replace_entries(path: Path, entries: Mapping[str, str]) -> None:
    try:
        import onnx
        from google.protobuf.message import DecodeError
    except ImportError as error:
        hint = 'install it with: pip install -e ".[train]"'
        raise InputError("writing an actor needs the onnx package", where=path, hint=hint) from error
    try:
        model = onnx.load(str(path))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=path) from error
    except DecodeError as error:
        raise InputError("not an ONNX model", where=path) from error
    ours = {*entries, MOTION_KEY, MOTION_SHA256_KEY}
    kept = {entry.key: entry.value for entry in model.metadata_props if entry.key not in ours}
    onnx.helper.set_model_props(model, kept | dict(entries))
    try:
        write_whole(path, model.SerializeToString())
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror})", where=path) from error
