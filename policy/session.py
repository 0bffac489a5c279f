"""Opening an ONNX graph for inference in one thread."""

from __future__ import annotations

from pathlib import Path

import onnxruntime
from onnxruntime.capi import onnxruntime_pybind11_state as ort_state

from core.errors import InputError

ORT_ERRORS = tuple(kind for kind in vars(ort_state).values() if isinstance(kind, type) and issubclass(kind, Exception))


def open_session(content: bytes, where: str | Path) -> onnxruntime.InferenceSession:
    """A CPU session of the model ``content``, one thread, nothing spinning.

    InputError, beginning with ``where``, if it is no model or one that this onnxruntime cannot run.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except ORT_ERRORS as error:
        expected = f"an ONNX model that onnxruntime {onnxruntime.__version__} can run"
        raise InputError(f"cannot be loaded ({one_line(error)})", where=where, expected=expected) from error


def one_line(error: Exception) -> str:
    """The message of ``error`` without line breaks, shortened."""
    text = " ".join(str(error).split())
    return text if len(text) <= 200 else text[:200] + "..."
