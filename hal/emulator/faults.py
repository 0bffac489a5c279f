"""What goes wrong on the emulated side of a wire, by script and on request."""

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from core import robot_time as time
from core.errors import InputError

EVERYTHING = "*"
T = TypeVar("T")


@dataclass(frozen=True)
class FaultKind:
    """What a kind of fault does. default: its value where none is given; None: the kind takes no value."""

    meaning: str
    default: float | None = None


COMMON_KINDS: Mapping[str, FaultKind] = {
    "silence": FaultKind("sends nothing, still hears"),
    "deaf": FaultKind("hears nothing, still sends"),
    "drop": FaultKind("loses what it sends; value: probability", 0.2),
    "delay": FaultKind("sends later; value: s", 0.03),
    "jitter": FaultKind("sends later by a random time; value: its upper end, s", 0.02),
    "corrupt": FaultKind("damages what it sends: bits flip, on CAN it is lost; value: probability", 1.0),
    "wrong_id": FaultKind("sends under another id; value: probability", 1.0),
    "stuck_joint": FaultKind("the joint does not move"),
    "over_temperature": FaultKind("reports a temperature; value: degrees Celsius", 120.0),
    "brown_out": FaultKind("has no power: no drive, sends and hears nothing; comes back disabled"),
    "fault_code": FaultKind("reports a fault, gives no torque; value: the device's own code, -1 its commonest", -1.0),
    "reconnect": FaultKind("the adapter goes away, and comes back with the fault's end"),
    "power_cycled_zero": FaultKind("positions are off; value: by how much, rad at the joint", 2.0 * math.pi),
    "wrong_position": FaultKind("says positions that are off; value: by how much, rad at the joint", 1.5),
    "wrong_speed": FaultKind("says speeds that are off; value: by how much, rad/s at the joint", 30.0),
}
SECOND_CONTROLLER = FaultKind("somebody else commands as well")
# Kinds under which nothing that a device sends arrives, and nothing that it is sent.
SENDS_NOTHING = ("silence", "brown_out", "reconnect")
HEARS_NOTHING = ("deaf", "brown_out", "reconnect")


@dataclass(frozen=True)
class EmulatedFault:
    """One fault of what is named `key` (a joint, a bus, `imu`, or `*`), from start_s for duration_s.

    Times are seconds after the emulator was ready. value: None means the kind's default.
    """

    kind: str
    key: str = EVERYTHING
    value: float | None = None
    start_s: float = 0.0
    duration_s: float = math.inf

    def __post_init__(self) -> None:
        """Check times and value. Raises InputError."""
        if not 0 <= self.start_s < math.inf:
            raise InputError("bad start", where=f"fault {self.kind}", got=self.start_s, expected="seconds >= 0")
        if not self.duration_s > 0:
            raise InputError("bad duration", where=f"fault {self.kind}", got=self.duration_s, expected="seconds > 0")
        if self.value is not None and not math.isfinite(self.value):
            raise InputError("bad value", where=f"fault {self.kind}", got=self.value, expected="a finite number")


def parse_fault(text: str) -> EmulatedFault:
    """`KIND[:KEY][=VALUE][@START[+DURATION]]`, such as `silence:left_knee_joint@5+0.5` or `delay=0.04`."""
    rest, _, times = text.partition("@")
    rest, _, value = rest.partition("=")
    kind, _, key = rest.partition(":")
    start, _, duration = times.partition("+")
    try:
        return EmulatedFault(
            kind.strip(),
            key.strip() or EVERYTHING,
            float(value) if value else None,
            float(start) if start else 0.0,
            float(duration) if duration else math.inf,
        )
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        expected = "KIND[:KEY][=VALUE][@START[+DURATION]], times in s"
        raise InputError("cannot be read", where="fault", got=text, expected=expected) from error


class Fate(NamedTuple):
    """What happens to one frame that a device sends."""

    lost: bool = False
    delay_s: float = 0.0
    corrupted: bool = False
    wrong_id: bool = False


UNHARMED = Fate()


class Faults:
    """All faults of one emulator. A device asks with every name that fits: its joint, its bus; `*` always fits.

    Thread-safe. kinds: what may be asked for. now: the clock, seconds.
    """

    def __init__(
        self,
        script: Sequence[EmulatedFault] = (),
        *,
        kinds: Mapping[str, FaultKind] = COMMON_KINDS,
        seed: int = 0,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.kinds = kinds
        self._now, self._rng = now, np.random.default_rng(seed)
        self._lock = threading.Lock()
        self._keys: frozenset[str] | None = None
        self._zero_s = now()
        self._faults: list[EmulatedFault] = []
        self._active: list[EmulatedFault] = []
        self._until_s = -math.inf
        for fault in script:
            self.add_at(fault)

    def begin(self, keys: Iterable[str]) -> None:
        """The emulator is ready: times count from now. keys: the names that exist. Raises InputError on others."""
        with self._lock:
            self._keys = frozenset(keys) | {EVERYTHING}
            for fault in self._faults:
                self._check(fault)
            self._zero_s, self._until_s = self._now(), -math.inf

    def add_at(self, fault: EmulatedFault) -> None:
        """A fault whose start counts from when the emulator was ready. Raises InputError on an unknown kind or key."""
        with self._lock:
            self._check(fault)
            self._faults.append(fault)
            self._until_s = -math.inf

    def add(
        self, kind: str, key: str = EVERYTHING, *, value: float | None = None, duration_s: float = math.inf
    ) -> None:
        """A fault from now on."""
        self.add_at(EmulatedFault(kind, key, value, max(0.0, self._now() - self._zero_s), duration_s))

    def clear(self, kind: str | None = None, key: str | None = None) -> int:
        """Forget the faults of a kind and a key (None: any). How many there were."""
        with self._lock:
            kept = [f for f in self._faults if (kind or f.kind) != f.kind or (key or f.key) != f.key]
            count, self._faults = len(self._faults) - len(kept), kept
            self._until_s = -math.inf
            return count

    def active(self, kind: str, *keys: str) -> EmulatedFault | None:
        """The first fault of a kind that strikes one of the keys now."""
        for fault in self._now_active():
            if fault.kind == kind and (fault.key == EVERYTHING or fault.key in keys):
                return fault
        return None

    def value(self, kind: str, *keys: str) -> float | None:
        """The value of that fault; None while there is none."""
        if not self._now_active() or (fault := self.active(kind, *keys)) is None:
            return None
        default = self.kinds[kind].default
        return fault.value if fault.value is not None else (math.nan if default is None else default)

    def fate(self, *keys: str) -> Fate:
        """What happens to a frame that is sent now."""
        if not self._now_active():
            return UNHARMED
        lost = any(self.active(kind, *keys) for kind in SENDS_NOTHING) or self._strikes("drop", keys)
        delay_s = self.value("delay", *keys) or 0.0
        if jitter_s := self.value("jitter", *keys):
            delay_s += self._uniform() * jitter_s
        return Fate(lost, delay_s, self._strikes("corrupt", keys), self._strikes("wrong_id", keys))

    def hears(self, *keys: str) -> bool:
        """Whether what is sent to the device arrives."""
        return not self._now_active() or not any(self.active(kind, *keys) for kind in HEARS_NOTHING)

    def powered(self, *keys: str) -> bool:
        """Whether the device has power."""
        return not self._now_active() or self.active("brown_out", *keys) is None

    def corrupted(self, data: bytes) -> bytes:
        """The bytes with one to three bits flipped."""
        if not data:
            return data
        with self._lock:
            count = int(self._rng.integers(1, 4))
            bits = self._rng.choice(8 * len(data), min(count, 8 * len(data)), replace=False)
        changed = bytearray(data)
        for bit in bits.tolist():
            changed[bit >> 3] ^= 1 << (bit & 7)
        return bytes(changed)

    @property
    def any_active(self) -> bool:
        """Whether anything is wrong now."""
        return bool(self._now_active())

    def struck(self, kind: str, names: Sequence[str]) -> np.ndarray:
        """(N,) bool: which of the names a kind strikes now."""
        if not self._now_active():
            return np.zeros(len(names), dtype=bool)
        return np.array([self.active(kind, name) is not None for name in names])

    def listing(self) -> list[dict[str, Any]]:
        """All faults, as plain data."""
        active = self._now_active()
        with self._lock:
            return [{"kind": f.kind, "key": f.key, "value": f.value, "active": f in active} for f in self._faults]

    def _check(self, fault: EmulatedFault) -> None:
        if fault.kind not in self.kinds:
            raise InputError("unknown fault", got=fault.kind, expected=f"one of {', '.join(sorted(self.kinds))}")
        if self._keys is not None and fault.key not in self._keys:
            expected = f"one of {', '.join(sorted(self._keys))}"
            raise InputError("unknown key", where=f"fault {fault.kind}", got=fault.key, expected=expected)
        if fault.value is not None and self.kinds[fault.kind].default is None:
            raise InputError("takes no value", where=f"fault {fault.kind}", got=fault.value)

    def _now_active(self) -> list[EmulatedFault]:
        if not self._faults:  # asked for every frame, mostly in vain
            return self._faults
        now_s = self._now()
        if now_s < self._until_s:
            return self._active
        with self._lock:
            t_s = now_s - self._zero_s
            edges = [e for f in self._faults for e in (f.start_s, f.start_s + f.duration_s) if e > t_s]
            self._active = [f for f in self._faults if f.start_s <= t_s < f.start_s + f.duration_s]
            self._until_s = self._zero_s + min(edges, default=math.inf)
            return self._active

    def _strikes(self, kind: str, keys: Sequence[str]) -> bool:
        chance = self.value(kind, *keys)
        return chance is not None and (chance >= 1.0 or self._uniform() < chance)

    def _uniform(self) -> float:
        with self._lock:
            return float(self._rng.random())


class DelayLine(Generic[T]):
    """Things on their way, in the order in which they were sent. For one thread."""

    def __init__(self) -> None:
        self._line: deque[tuple[float, T]] = deque()

    def put(self, due_s: float, item: T) -> None:
        """Send something that arrives at due_s, or right after what was sent before."""
        self._line.append((max(due_s, self._line[-1][0]) if self._line else due_s, item))

    @property
    def due_s(self) -> float:
        """When the next one arrives; inf for none."""
        return self._line[0][0] if self._line else math.inf

    def arrived(self, now_s: float) -> list[T]:
        """Take out what has arrived."""
        items = []
        while self._line and self._line[0][0] <= now_s:
            items.append(self._line.popleft()[1])
        return items
