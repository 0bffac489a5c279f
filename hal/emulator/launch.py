"""Starting an emulator as a process of its own, and ending it."""

import contextlib
import json
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, Self

from core.errors import InputError
from core.processes import without_windows
from hal.contract.types import DeviceError
from hal.emulator.control import ControlClient
from world.scene import FLAT, Scene

BAD_INPUT = 2
START_LIMIT_S = 30.0
TERMINATE_S = 1.5
COMMAND = Path(__file__).resolve().parents[1] / "emulate"


class Emulator:
    """A running emulator process. Use as a context manager: leaving ends it, within 2 s."""

    def __init__(self, process: "subprocess.Popen[bytes]", ready: Mapping[str, Any], errors: IO[bytes]) -> None:
        self._process, self._errors = process, errors
        self.endpoints: dict[str, str] = dict(ready["endpoints"])
        self.control = ControlClient(str(ready["control"]))

    @property
    def pid(self) -> int:
        """Of the emulator's process."""
        return self._process.pid

    def stop(self) -> None:
        """End it. May be repeated."""
        self.control.close()
        _end(self._process)
        self._errors.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.stop()


def launch_emulator(
    kind: str,
    config: str | Path | None = None,
    *,
    robot: str = "g1_23dof",
    scene: Scene = FLAT,
    faults: Sequence[str] = (),
    start_noise_rad: float = 0.0,
    seed: int = 0,
) -> Emulator:
    """Start an emulator and wait until it can be connected to.

    kind: dds, can, dynamixel or imu. scene: what the robot stands in. faults: as for `hal/emulate --fault`. The
    process ignores the terminal's signals and ends a few seconds after this one, whatever happens to it. Raises
    InputError where it refuses its options, DeviceError where it cannot start.
    """
    command = [sys.executable, "-P", str(COMMAND), kind, "--lifeline", "--robot", robot]
    command += ["--seed", str(seed), "--start-noise", repr(start_noise_rad)]
    command += [] if scene == FLAT else ["--scene", json.dumps(asdict(scene))]
    command += [] if config is None else ["--config", str(config)]
    return start_emulator([*command, *(f"--fault={fault}" for fault in faults)])


def start_emulator(command: Sequence[str]) -> Emulator:
    """Start a command that behaves as `hal/emulate --lifeline`. Raises as `launch_emulator`."""
    errors = tempfile.TemporaryFile()  # noqa: SIM115  it lives as long as the process
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command, stdin=pipe, stdout=pipe, stderr=errors, start_new_session=True, env=without_windows()
    )
    try:
        ready = _first_line(process)
        if ready is None:
            raise _refusal(process, errors)
        return Emulator(process, ready, errors)
    except BaseException:
        _end(process)
        errors.close()
        raise


def _first_line(process: "subprocess.Popen[bytes]") -> dict[str, Any] | None:
    """What the emulator says when it is ready; None where it ended or took too long."""
    lines: queue.Queue[bytes] = queue.Queue()
    output = process.stdout
    assert output is not None
    threading.Thread(target=lambda: lines.put(output.readline()), daemon=True).start()
    try:
        line = lines.get(timeout=START_LIMIT_S)
    except queue.Empty:
        return None
    return json.loads(line) if line else None


def _refusal(process: "subprocess.Popen[bytes]", errors: IO[bytes]) -> Exception:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(TERMINATE_S)
    _end(process)
    reason = _last_words(errors) or f"no answer within {START_LIMIT_S:g} s"
    if process.returncode == BAD_INPUT:
        return InputError(reason, where="emulator")
    return DeviceError(f"emulator did not start: {reason}")


def _last_words(errors: IO[bytes]) -> str:
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    return lines[-1].removeprefix("error: ") if lines else ""


def _end(process: "subprocess.Popen[bytes]") -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    if process.poll() is None:
        process.terminate()
    try:
        process.wait(TERMINATE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
