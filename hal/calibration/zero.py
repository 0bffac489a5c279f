"""The command `hal/zero`: find one joint's `zero_rad`, by hand or against a stop."""

import math
import re
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from core.arguments import ArgumentParser
from core.config import config_file
from core.errors import InputError
from core.files import write_whole
from hal.calibration.bench import Bench, JointReading
from hal.calibration.consent import DONE, Ask, add_wire_options, consent, load_wires, run_command
from hal.calibration.jog import TORQUE_SHARE, TORQUE_SHARE_MAX, require_watchdog
from hal.contract.types import DeviceError

SPEED_RAD_S = 0.15
STALLED_RAD_S, STALLED_S = 0.02, 0.6
TORQUE_REACHED = 0.6
LEAD_RAD = 0.5


def main(arguments: Sequence[str] | None = None, *, ask: Ask | None = None) -> int:
    """Returns 0 done or stopped, 2 bad input or not agreed, 4 device."""
    return run_command(lambda: _zero(arguments, ask))


def _zero(arguments: Sequence[str] | None, ask: Ask | None) -> int:
    given = _parser().parse_args(arguments)
    if given.in_motor and given.stop:  # a servo that is driven would turn to where its target lies from the new zero
        raise InputError("--in-motor", got=f"--stop {given.stop}", expected="a joint that is held by hand")
    file, robot = load_wires(given.config, given.at)
    share = given.torque_share
    if not 0 < share <= TORQUE_SHARE_MAX:
        raise InputError("--torque-share", got=f"{share:g}", expected=f"above 0 and at most {TORQUE_SHARE_MAX:g}")
    limit_nm = Bench(file, robot, given.joint, torque_nm=1.0, calibrated=False).limit_nm
    with Bench(file, robot, given.joint, torque_nm=share * limit_nm, calibrated=False) as bench:
        lower, upper = bench.range_rad
        angle_rad = {"lower": lower, "upper": upper}.get(given.stop, given.angle)
        if not lower <= angle_rad <= upper:
            raise InputError("--angle", got=angle_rad, expected=f"within {lower:g} to {upper:g} rad")
        found = _by_hand(bench, angle_rad, ask) if given.stop is None else _at_stop(bench, given, ask)
        if given.in_motor:
            bench.set_zero_in_motor()
            found = bench.read_still()
        zero_rad = zero_of(bench.entry, found.raw_rad, angle_rad)
        bench.mark_zeroed(zero_rad)
    return settle(given.config, given.joint, bench.entry.zero_rad, zero_rad, write=given.write, ask=ask)


def settle(config: str, joint: str, before_rad: float, zero_rad: float, *, write: bool, ask: Ask | None) -> int:
    """Say what was found and, where asked for and agreed, write it into the robot's file. The command's exit code."""
    print(f"{joint}: zero_rad {before_rad:g} -> {zero_rad:.4f}")
    path = config_file("hal", config)
    if not write:
        print(f"put `zero_rad: {zero_rad:.4f}` into its line of {path}, or repeat with --write")
        return DONE
    consent(joint, f"{path} will be changed", ask)
    write_zero(path, joint, zero_rad)
    return DONE


class Mapped(Protocol):
    """A motor or servo as its file says: q = direction (raw - zero_rad) / gear. fold: single-turn, see JointMap."""

    @property
    def direction(self) -> int:
        """1 or -1."""
        ...

    @property
    def gear(self) -> float:
        """Of a stage behind it."""
        ...

    @property
    def fold(self) -> bool:
        """Whether whole turns are found from the joint's range."""
        ...


def zero_of(entry: Mapped, raw_rad: float, angle_rad: float) -> float:
    """zero_rad that makes this motor position this joint angle; for single-turn encoders within half a turn of 0."""
    zero_rad = raw_rad - entry.direction * entry.gear * angle_rad
    return math.remainder(zero_rad, 2.0 * math.pi) if entry.fold else zero_rad


def write_zero(path: Path, joint: str, zero_rad: float) -> None:
    """Change the number in the joint's line, or add it there, and nothing else.

    Raises InputError where there is no such single line.
    """
    lines = path.read_text().splitlines(keepends=True)
    rows = [i for i, line in enumerate(lines) if re.search(rf"\bjoint:\s*{re.escape(joint)}\b", line.split("#")[0])]
    changed = _with_zero(lines[rows[0]], zero_rad) if len(rows) == 1 else None
    if changed is None:
        hint = f"write `zero_rad: {zero_rad:.4f}` by hand"
        raise InputError(f"no single line {{joint: {joint}, ...}}", where=path, hint=hint)
    lines[rows[0]] = changed
    write_whole(path, "".join(lines).encode())


def _with_zero(line: str, zero_rad: float) -> str | None:
    """A joint's line {...} with another zero; None where it is none."""
    entry, comment = re.fullmatch(r"([^#]*)(.*)", line, flags=re.DOTALL).groups()  # type: ignore[union-attr]
    if len(re.findall(r"\bzero_rad:", entry)) == 1:
        return re.sub(r"(\bzero_rad:\s*)[-+.\deE]+", rf"\g<1>{zero_rad:.4f}", entry) + comment
    closed = re.fullmatch(r"([^{}]*\{[^{}]*?)(,?\s*\}\s*)", entry, flags=re.DOTALL)
    if "zero_rad" in entry or closed is None:
        return None
    return f"{closed[1]}, zero_rad: {zero_rad:.4f}{closed[2]}{comment}"


def _by_hand(bench: Bench, angle_rad: float, ask: Ask | None) -> JointReading:
    what = f"{bench.joint} is slack. Hold it at {angle_rad:+.4f} rad and keep it still."
    consent(bench.joint, what, ask)
    return bench.read_still()


def _at_stop(bench: Bench, given: Namespace, ask: Ask | None) -> JointReading:
    """Pull towards the stop until the joint does not move any more though the torque is there."""
    require_watchdog(bench, given.without_watchdog)
    sign = 1.0 if given.stop == "upper" else -1.0
    what = f"{bench.joint} will turn {'up' if sign > 0 else 'down'} to its {given.stop} stop at {SPEED_RAD_S:g} rad/s "
    consent(bench.joint, f"{what}with at most {bench.torque_nm:.1f} Nm. Keep clear.", ask)
    bench.switch_on()
    reading = start = bench.last
    target_rad, stalled_s = start.pos_rad, 0.0
    lower, upper = bench.range_rad
    while stalled_s < STALLED_S:
        if abs(reading.pos_rad - start.pos_rad) > upper - lower + LEAD_RAD:
            raise DeviceError(f"{bench.joint}: has turned further than its range and met no stop")
        target_rad += sign * SPEED_RAD_S * bench.period_s
        target_rad = sign * min(sign * target_rad, sign * reading.pos_rad + LEAD_RAD)
        reading = bench.drive(target_rad)
        pulling = sign * reading.torque_nm > TORQUE_REACHED * bench.torque_nm
        still = abs(reading.vel_rad_s) < STALLED_RAD_S
        stalled_s = stalled_s + bench.period_s if pulling and still else 0.0
    return reading


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="hal/zero",
        description="Find the zero of one joint: hold it at a known angle by hand, or let it lean against a stop.",
        epilog="Exit codes: 0 done or stopped, 2 bad input or not agreed, 4 device.",
        allow_abbrev=False,
    )
    parser.add_argument("joint")
    add_wire_options(parser)
    parser.add_argument("--angle", type=float, default=0.0, metavar="RAD", help="where you hold it")
    parser.add_argument("--stop", choices=("lower", "upper"), help="turn it gently to this end of its range instead")
    parser.add_argument(
        "--torque-share", type=float, default=TORQUE_SHARE, metavar="SHARE", help="of the joint's limit, for --stop"
    )
    parser.add_argument("--in-motor", action="store_true", help="set the servo's own zero as well, by hand only")
    parser.add_argument("--write", action="store_true", help="change the robot file, after asking")
    parser.add_argument("--without-watchdog", action="store_true", help="the servo has none, and you stand by")
    return parser
