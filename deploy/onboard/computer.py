"""What is checked of the computer on board, row by row, from /sys, /proc and /run."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

SLEEP_STATES = ("mem", "disk", "standby", "freeze")
CAN_HARDWARE = "280"
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23


@dataclass(frozen=True)
class Wanted:
    """See configs/onboard/doctor.yaml."""

    cores: int
    rtprio: int
    wake_up_s: float
    wake_up_period_s: float
    wake_up_p99_us: float
    wake_up_max_us: float
    can_queue: int
    usb_latency_ms: int


@dataclass(frozen=True)
class Row:
    """One thing checked. remedy: what to do where it is not good."""

    what: str
    good: bool
    found: str
    wanted: str
    remedy: str


@dataclass(frozen=True)
class Computer:
    """Reads below `root`, which is / but in tests. What is not there reads as empty."""

    root: Path
    wanted: Wanted

    def rows(self) -> Iterator[Row]:
        """Every row but the measured one."""
        checks: tuple[Callable[[], Row], ...] = (
            self.kernel, self.cores, self.governor, self.isolated, self.priority, self.memory_lock, self.suspend,
            self.mains,
        )  # fmt: skip
        yield from (check() for check in checks)
        yield from self.can_queues()
        yield from self.usb_latencies()

    def kernel(self) -> Row:
        """A kernel that can be pre-empted everywhere."""
        version = self._read("proc/version")
        good = "PREEMPT_RT" in version or self._read("sys/kernel/realtime") == "1"
        kind = re.search(r"PREEMPT\w*", version)
        found = " ".join([*version.split()[2:3], kind.group() if kind else "no PREEMPT"])
        remedy = "install a real-time kernel: linux-image-rt-amd64 or -arm64 on Debian, pro enable realtime on Ubuntu"
        return Row("kernel", good, found, "PREEMPT_RT", remedy)

    def cores(self) -> Row:
        """Processors in use."""
        number = len(_numbers(self._read("sys/devices/system/cpu/online")))
        wanted = f"at least {self.wanted.cores}"
        return Row("cores", number >= self.wanted.cores, str(number), wanted, "loop and wire need a core each")

    def governor(self) -> Row:
        """Processors that do not slow down between ticks."""
        files = self._glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
        found = sorted({file.read_text().strip() for file in files})
        remedy = "cpupower frequency-set -g performance, and in /etc/default/cpupower for the next start"
        return Row("governor", set(found) <= {"performance"}, ", ".join(found) or "none", "performance", remedy)

    def isolated(self) -> Row:
        """A core that the kernel gives to nobody else."""
        listed = self._read("sys/devices/system/cpu/isolated")
        last = max(_numbers(self._read("sys/devices/system/cpu/online")), default=0)
        remedy = f"isolcpus={last} nohz_full={last} rcu_nocbs={last} on the kernel's command line"
        remedy += f", and CPUAffinity={last} in kata.service"
        return Row("isolated cores", bool(_numbers(listed)), listed or "none", "one for the loop", remedy)

    def priority(self) -> Row:
        """Whether SCHED_FIFO is granted."""
        limit = self._limit("Max realtime priority")
        good = self._may(CAP_SYS_NICE) or limit == "unlimited" or int(limit or 0) >= self.wanted.rtprio
        found = "CAP_SYS_NICE" if self._may(CAP_SYS_NICE) else limit or "unknown"
        remedy = "copy deploy/onboard/kata-limits.conf to /etc/security/limits.d, join its group, log in again"
        return Row("real-time priority", good, found, f"rtprio {self.wanted.rtprio}", remedy)

    def memory_lock(self) -> Row:
        """Whether memory can be kept from being paged out."""
        limit = self._limit("Max locked memory")
        good = self._may(CAP_IPC_LOCK) or limit == "unlimited"
        found = "CAP_IPC_LOCK" if self._may(CAP_IPC_LOCK) else limit or "unknown"
        return Row("memory lock", good, found, "unlimited", "as for the real-time priority")

    def suspend(self) -> Row:
        """Whether the computer can fall asleep under a standing robot."""
        states = [state for state in self._read("sys/power/state").split() if state in SLEEP_STATES]
        target = self.root / "etc/systemd/system/sleep.target"
        blocked = [text for text in self._texts("run/systemd/inhibit/*") if _blocks_sleep(text)]
        if not states:
            found = "the kernel cannot"
        elif target.is_symlink() and str(target.readlink()) == "/dev/null":
            found = "sleep.target is masked"
        else:
            found = "blocked by an inhibitor" if blocked else f"possible ({', '.join(states)})"
        good = not found.startswith("possible")
        remedy = "systemctl mask sleep.target suspend.target hibernate.target, or run under systemd-inhibit"
        return Row("suspend", good, found, "impossible", remedy)

    def mains(self) -> Row:
        """Whether a battery of the computer's own is running down."""
        draining = "Discharging" in self._texts("sys/class/power_supply/*/status")
        found = "own battery, discharging" if draining else "no battery of its own, or not discharging"
        return Row("power", not draining, found, "not discharging", "plug it in: a computer on battery slows down")

    def can_queues(self) -> Iterator[Row]:
        """CAN interfaces: up, with a queue in which nothing grows old."""
        for kind in self._glob("sys/class/net/*/type"):
            if kind.read_text().strip() != CAN_HARDWARE:
                continue
            name = kind.parent.name
            here = f"sys/class/net/{name}"
            queue, flags = self._read(f"{here}/tx_queue_len"), int(self._read(f"{here}/flags") or "0", 16)
            up = bool(flags & 1)
            good = up and queue.isdigit() and int(queue) <= self.wanted.can_queue
            wanted = f"up, at most {self.wanted.can_queue} frames"
            remedy = f"deploy/onboard/99-kata.rules, or ip link set {name} txqueuelen {self.wanted.can_queue} up"
            yield Row(f"queue of {name}", good, f"{'up' if up else 'down'}, {queue} frames", wanted, remedy)

    def usb_latencies(self) -> Iterator[Row]:
        """USB serial adapters that hand bytes on at once."""
        for timer in self._glob("sys/bus/usb-serial/devices/*/latency_timer"):
            found, wanted = timer.read_text().strip(), self.wanted.usb_latency_ms
            good = found.isdigit() and int(found) <= wanted
            remedy = f"deploy/onboard/99-kata.rules, or echo {wanted} > /{timer.relative_to(self.root)}"
            yield Row(f"latency of {timer.parent.name}", good, f"{found} ms", f"{wanted} ms", remedy)

    def _read(self, name: str) -> str:
        try:
            return (self.root / name).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return ""

    def _glob(self, pattern: str) -> list[Path]:
        return sorted(self.root.glob(pattern))

    def _texts(self, pattern: str) -> list[str]:
        return [self._read(str(path.relative_to(self.root))) for path in self._glob(pattern)]

    def _limit(self, name: str) -> str:
        """The soft limit of this process."""
        row = re.search(rf"^{name}\s+(\S+)", self._read("proc/self/limits"), flags=re.MULTILINE)
        return row.group(1) if row else ""

    def _may(self, capability: int) -> bool:
        row = re.search(r"^CapEff:\s+([0-9a-f]+)", self._read("proc/self/status"), flags=re.MULTILINE)
        return bool(row and int(row.group(1), 16) >> capability & 1)


def _blocks_sleep(text: str) -> bool:
    fields = dict(row.partition("=")[::2] for row in text.splitlines())
    return "sleep" in fields.get("WHAT", "").split(":") and fields.get("MODE") == "block"


def _numbers(listed: str) -> list[int]:
    """The kernel's lists, such as 0-2,5."""
    numbers: list[int] = []
    for part in filter(None, listed.split(",")):
        first, _, last = part.partition("-")
        numbers += range(int(first), int(last or first) + 1)
    return numbers
