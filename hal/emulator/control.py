"""The emulator's own control socket: JSON lines on loopback, never on the emulated wire."""

import contextlib
import io
import json
import socket
import threading
from collections.abc import Callable, Mapping
from typing import Any, Self

from core.errors import InputError
from core.robot_time import Pace
from hal.contract.types import DeviceError

HOST = "127.0.0.1"
BACKLOG = 8
TIMEOUT_S = 5.0
LONGEST_LINE = 1 << 20
Handler = Callable[[Mapping[str, Any]], dict[str, Any]]


class ControlServer:
    """Answers each line, a JSON object with `do`, by one line: `{"ok": true, ...}` or `{"ok": false, "error": ...}`."""

    def __init__(self, handle: Handler) -> None:
        self._handle = handle
        self._socket = socket.create_server((HOST, 0), backlog=BACKLOG)
        self._thread = threading.Thread(target=self._accept, name="control", daemon=True)

    @property
    def address(self) -> str:
        """`host:port`."""
        host, port = self._socket.getsockname()[:2]
        return f"{host}:{port}"

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """Take no more connections. May be repeated."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), name="control client", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, connection.makefile("rwb") as stream, contextlib.suppress(OSError):
            while line := stream.readline(LONGEST_LINE):
                stream.write(json.dumps(self._answer(line)).encode() + b"\n")
                stream.flush()

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict) or not isinstance(request.get("do"), str):
                raise InputError("not a request", got=line[:80], expected='a JSON object with "do"')
            return {"ok": True, **self._handle(request)}
        except (ValueError, TypeError, KeyError) as error:
            return {"ok": False, "error": f"{error}"}


class ControlClient:
    """The other end. Every method raises DeviceError where the emulator is gone, InputError where it refuses.

    An answer that does not come within timeout_s is given up together with its connection, so that it cannot be taken
    for that of a later request; the next request connects anew.
    """

    def __init__(self, address: str, *, timeout_s: float = TIMEOUT_S) -> None:
        self.address, self.timeout_s = address, timeout_s
        self._lock = threading.Lock()
        self._closed = False
        self._stream: io.BufferedRWPair | None = self._connect()

    def release_gantry(self) -> None:
        """Let the robot go, gently."""
        self.ask("release_gantry")

    def lean(self, *, forwards_rad: float = 0.0, left_rad: float = 0.0) -> None:
        """Lean the base by hand within a second, and hold it there."""
        self.ask("lean", forwards_rad=forwards_rad, left_rad=left_rad)

    def reset(self, *, start_noise_rad: float = 0.0, seed: int = 0, lift_m: float = 0.0) -> None:
        """Hang the robot up anew, lifted from the ground or on it, its devices as after switching on; faults stay."""
        self.ask("reset", start_noise_rad=start_noise_rad, seed=seed, lift_m=lift_m)

    def fault(self, kind: str, key: str = "*", *, value: float | None = None, duration_s: float | None = None) -> None:
        """Begin a fault now; without a duration it lasts until it is cleared."""
        self.ask("fault", kind=kind, key=key, value=value, duration_s=duration_s)

    def clear_fault(self, kind: str | None = None, key: str | None = None) -> int:
        """End the faults of a kind and a key (None: all). How many there were."""
        return int(self.ask("clear_fault", kind=kind, key=key)["cleared"])

    def status(self) -> dict[str, Any]:
        """See EmulatedRobot.status; besides: `faults`, `device`, `kind`."""
        return self.ask("status")

    def gantry_attached(self) -> bool:
        """Whether the gantry pulls."""
        return bool(self.ask("gantry")["attached"])

    def device(self, **content: Any) -> dict[str, Any]:
        """Something only this kind of device knows."""
        return self.ask("device", **content)

    def follow(self, pace: Pace) -> None:
        """Let the emulator's time go by a pace when it begins."""
        self.ask("follow", **pace._asdict())

    def quit(self) -> None:
        """End the emulator."""
        self.ask("quit")

    def ask(self, do: str, **content: Any) -> dict[str, Any]:
        """One request and its answer."""
        with self._lock:
            if self._closed:
                raise DeviceError(f"emulator at {self.address}: this client was closed")
            stream = self._stream = self._stream or self._connect()
            try:
                stream.write(json.dumps({"do": do, **content}).encode() + b"\n")
                stream.flush()
                line = stream.readline(LONGEST_LINE)
            except OSError as error:
                self._hang_up()
                raise DeviceError(f"emulator at {self.address}: no answer to {do!r}: {error}") from error
            if not line:
                self._hang_up()
                raise DeviceError(f"emulator at {self.address}: it has ended")
        answer: dict[str, Any] = json.loads(line)
        if not answer.pop("ok"):
            raise InputError(str(answer["error"]), where="emulator")
        return answer

    def close(self) -> None:
        """Hang up for good. May be repeated."""
        self._closed = True
        self._hang_up()

    def _connect(self) -> io.BufferedRWPair:
        host, _, port = self.address.rpartition(":")
        try:
            with socket.create_connection((host, int(port)), timeout=self.timeout_s) as connection:
                return connection.makefile("rwb")
        except OSError as error:
            raise DeviceError(f"emulator at {self.address}: {error}") from error

    def _hang_up(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Hang up."""
        self.close()
