"""Notes on this computer that the zero of a motor was found; for motors that can keep nothing without power.

A note counts until the computer restarts, or until the motor is silent in a run for as long as a power cut takes.
"""

import json
import os
import threading
from pathlib import Path

from core.files import write_json
from hal.can.codec import Codec
from hal.contract.types import DeviceFault

NOTES = Path(__file__).resolve().parents[2] / "runs" / "zeros"
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def leave_note(where: str, codec: Codec, mark: float) -> None:
    """mark: which zero was found. where: the motor's wire."""
    path = _path(where, codec)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {"mark": mark, "boot": _boot()})


def read_note(where: str, codec: Codec) -> float:
    """The mark; 0 where there is none that counts. Raises DeviceFault where this program could not take it back."""
    if NOTES.exists() and not os.access(NOTES, os.W_OK):
        raise DeviceFault(f"{NOTES}: cannot be written, so that a lost zero would be forgotten: make it yours")
    try:
        content = json.loads(_path(where, codec).read_text(encoding="utf-8"))
        return float(content["mark"]) if content["boot"] == _boot() else 0.0
    except (OSError, ValueError, KeyError, TypeError):
        return 0.0


def forget_soon(where: str, codec: Codec) -> None:
    """The motor may have been without power. A disk may be slow: another thread waits for it."""
    threading.Thread(target=_path(where, codec).unlink, kwargs={"missing_ok": True}, daemon=True).start()


def _path(where: str, codec: Codec) -> Path:
    name = "".join(c if c.isalnum() else "-" for c in f"{where} {codec.name} {codec.motor_id}")
    return NOTES / f"{name}.json"


def _boot() -> str:
    return BOOT_ID.read_text(encoding="ascii").strip()
