"""What the system says of the adapter behind a serial port or a network interface."""

import json
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

CLASSES = Path("/sys/class")
LONGEST_QUEUE = 64
ANSWER_LIMIT_S = 2.0


def adapter_serial(path_or_name: str, kind: str, classes: Path = CLASSES) -> str:
    """The serial number of the USB adapter behind a device file (kind "tty") or an interface (kind "net").

    Empty where there is none: another kind of device, or an adapter whose maker gave it no number.
    """
    name = Path(path_or_name).resolve().name if kind == "tty" else path_or_name
    device = classes / kind / name / "device"
    if not name or not device.exists():
        return ""
    for folder in (device.resolve(), *device.resolve().parents):
        try:
            return (folder / "serial").read_text(encoding="utf-8").strip()
        except (OSError, ValueError):
            continue
    return ""


@dataclass(frozen=True)
class CanInterface:
    """A SocketCAN interface as it is set up. None: the system does not say. adapter: a device is behind it."""

    name: str
    queue: int | None = None
    state: str | None = None
    restart_ms: int | None = None
    adapter: bool = False

    @property
    def problems(self) -> list[str]:
        """Why nothing should be driven over it."""
        found = []
        if self.state in ("BUS-OFF", "STOPPED"):
            found.append(f"{self.name} is {self.state}: take it down and up, and look for a short or a wrong bit rate")
        if self.adapter and self.restart_ms is None:
            found.append(f"{self.name}: state and restart time cannot be read: install iproute2, and try again")
        if self.queue is not None and self.queue > LONGEST_QUEUE:
            found.append(
                f"{self.name} queues {self.queue} frames and would replay them when power comes back: "
                f"ip link set {self.name} txqueuelen 16"
            )
        if self.restart_ms:
            found.append(
                f"{self.name} restarts by itself {self.restart_ms} ms after a bus-off: "
                f"ip link set {self.name} type can restart-ms 0"
            )
        return found

    def __str__(self) -> str:
        """In one line."""
        queue = "unknown" if self.queue is None else f"{self.queue} frames"
        restart = "unknown" if self.restart_ms is None else f"{self.restart_ms} ms"
        return f"queue {queue}, restart {restart}, state {self.state or 'unknown'}"


def can_interface(name: str, classes: Path = CLASSES) -> CanInterface | None:
    """The set-up of a SocketCAN interface; None where there is no such interface."""
    folder = classes / "net" / name
    if not folder.exists():
        return None
    try:
        queue = int((folder / "tx_queue_len").read_text(encoding="ascii"))
    except (OSError, ValueError):
        queue = None
    return _with_state(CanInterface(name, queue, adapter=(folder / "device").exists()))


def _with_state(interface: CanInterface) -> CanInterface:
    """State and restart time live in netlink only, which `ip` speaks."""
    command = ["ip", "-details", "-json", "link", "show", "dev", interface.name]
    try:
        answer = subprocess.run(command, capture_output=True, timeout=ANSWER_LIMIT_S, check=True).stdout
        data = json.loads(answer)[0]["linkinfo"]["info_data"]
        return replace(interface, state=data.get("state"), restart_ms=int(data.get("restart_ms", 0)))
    except (OSError, subprocess.SubprocessError, ValueError, KeyError, IndexError, TypeError):
        return interface
