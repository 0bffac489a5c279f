"""How long frames are on a CAN wire, and the highest rate that a bus full of servos can be polled at."""

from collections.abc import Sequence
from dataclasses import dataclass

from core.errors import InputError
from hal.can.codec import MotorCommand, MotorState
from hal.can.frame import CLASSIC_LENGTH_MAX, Frame
from hal.can.robot_file import BusEntry, RobotFile

MAX_LOAD = 0.8
SPACE_BITS = 3
# ISO 11898-1, bits from start of frame to end of frame, without data: classic, then the two phases of FD.
CLASSIC_BITS, CLASSIC_EXTENDED_BITS = 44, 64
CLASSIC_STUFFABLE, CLASSIC_EXTENDED_STUFFABLE = 34, 54
FD_ARBITRATION_BITS, FD_ARBITRATION_EXTENDED_BITS, FD_END_BITS = 17, 36, 9
FD_CONTROL_BITS, FD_STUFF_COUNT_BITS, FD_DELIMITER_BITS = 5, 4, 1
FD_SHORT_CRC, FD_LONG_CRC, FD_SHORT_DATA = (17, 6), (21, 7), 16
BUSY = MotorCommand(q_rad=0.1, dq_rad_s=0.1, kp=1.0, kd=1.0, tau_nm=0.1)
MOVING = MotorState(pos_rad=0.1, vel_rad_s=0.1, torque_nm=0.1, enabled=True)


@dataclass(frozen=True)
class BusLoad:
    """One bus: round_s, all commands and answers with the most stuff bits possible; ceiling_hz: back to back."""

    bus: str
    motors: int
    frames: int
    round_s: float
    ceiling_hz: float
    rate_hz: float

    @property
    def load(self) -> float:
        """Share of the wire's time that the configured rate takes."""
        return self.rate_hz / self.ceiling_hz


def frame_time_s(frame: Frame, bitrate: int, data_bitrate: int, *, stuffed: bool = True) -> float:
    """Time on the wire, the space between frames included. stuffed: with the most stuff bits that data can cause."""
    if frame.fd:
        return _fd_time_s(frame, bitrate, data_bitrate, stuffed)
    data_bits = 0 if frame.remote else 8 * min(len(frame.data), CLASSIC_LENGTH_MAX)
    bits = data_bits + SPACE_BITS + (CLASSIC_EXTENDED_BITS if frame.extended else CLASSIC_BITS)
    stuffable = data_bits + (CLASSIC_EXTENDED_STUFFABLE if frame.extended else CLASSIC_STUFFABLE)
    return (bits + (_stuff_bits(stuffable) if stuffed else 0)) / bitrate


def bus_loads(file: RobotFile) -> tuple[BusLoad, ...]:
    """Every bus of a robot, computed from the frames that its codecs really make."""
    return tuple(bus_load(file, bus) for bus in file.buses)


def bus_load(file: RobotFile, bus: BusEntry) -> BusLoad:
    """One bus. Answers to commands count once a round; what motors send by themselves, as often as they send it."""
    codecs = [file.codecs[i] for i in file.motors_of(bus.name)]
    round_s, frames = 0.0, 0
    cyclic_share = 0.0
    for codec in codecs:
        answers = codec.feedback_frames(MOVING)
        sent = codec.command(BUSY)
        frames += len(sent) + len(answers)
        round_s += sum(frame_time_s(frame, bus.bitrate, bus.data_bitrate) for frame in sent)
        answer_s = sum(frame_time_s(frame, bus.bitrate, bus.data_bitrate) for frame in answers)
        if codec.cyclic_period_s is None:
            round_s += answer_s
        else:
            cyclic_share += answer_s / codec.cyclic_period_s
    ceiling_hz = float("inf") if round_s == 0.0 else max(1e-9, 1.0 - cyclic_share) / round_s
    return BusLoad(bus.name, len(codecs), frames, round_s, ceiling_hz, file.rate_hz)


def check_loads(loads: Sequence[BusLoad]) -> None:
    """Raise InputError naming each bus that the rate would fill above 80 %."""
    full = [load for load in loads if load.load > MAX_LOAD]
    if full:
        raise InputError(
            "too much traffic",
            where=", ".join(f"bus {load.bus}" for load in full),
            got=", ".join(f"{load.load:.0%} at {load.rate_hz:g} Hz" for load in full),
            expected=f"at most {MAX_LOAD:.0%}: rate_hz up to {MAX_LOAD * min(load.ceiling_hz for load in full):.0f}",
            hint="lower the rate or spread the motors over more buses",
        )


def load_table(loads: Sequence[BusLoad]) -> str:
    """The loads as lines of text."""
    lines = [f"{'bus':<14}{'motors':>7}{'frames':>8}{'round':>10}{'ceiling':>10}{'rate':>9}{'load':>7}"]
    for load in loads:
        lines.append(
            f"{load.bus:<14}{load.motors:>7}{load.frames:>8}{1e6 * load.round_s:>7.0f} us{load.ceiling_hz:>7.0f} Hz"
            f"{load.rate_hz:>6.0f} Hz{load.load:>7.0%}"
        )
    return "\n".join(lines)


def _fd_time_s(frame: Frame, bitrate: int, data_bitrate: int, stuffed: bool) -> float:
    slow = FD_ARBITRATION_EXTENDED_BITS if frame.extended else FD_ARBITRATION_BITS
    payload = FD_CONTROL_BITS + 8 * len(frame.data)
    crc, fixed_stuff = FD_SHORT_CRC if len(frame.data) <= FD_SHORT_DATA else FD_LONG_CRC
    fast = payload + FD_STUFF_COUNT_BITS + crc + fixed_stuff + FD_DELIMITER_BITS
    slow_stuff = _stuff_bits(slow) if stuffed else 0
    fast_stuff = _stuff_bits(slow + payload) - slow_stuff if stuffed else 0
    return (slow + slow_stuff + FD_END_BITS + SPACE_BITS) / bitrate + (fast + fast_stuff) / data_bitrate


def _stuff_bits(stuffable: int) -> int:
    return (stuffable - 1) // 4
