"""The command `hal/jog`: turn one joint a little, gently, to see that the right one turns the right way.

The sign of `direction` comes before the zero, so a motor whose zero nobody knows yet can be turned from where it is.
"""

import math
from collections.abc import Sequence

from core.arguments import ArgumentParser
from core.errors import InputError
from hal.calibration.bench import Bench, JointReading
from hal.calibration.consent import DONE, Ask, add_wire_options, consent, load_wires, run_command

TORQUE_SHARE, TORQUE_SHARE_MAX = 0.05, 0.2
BY_MAX_RAD, SPEED_MAX_RAD_S = 0.5, 0.5
BY_MAX_UNKNOWN_RAD, SPEED_MAX_UNKNOWN_RAD_S = 0.1, 0.2
HOLD_S = 0.5
MOVED_SHARE = 0.2
UNKNOWN = "has no known zero, so nobody knows how near its stops are; it begins where it is"


def main(arguments: Sequence[str] | None = None, *, ask: Ask | None = None) -> int:
    """Returns 0 done or stopped, 2 bad input or not agreed, 4 device."""
    return run_command(lambda: _jog(arguments, ask))


def _jog(arguments: Sequence[str] | None, ask: Ask | None) -> int:
    given = _parser().parse_args(arguments)
    file, robot = load_wires(given.config, given.at)
    known = not given.from_here
    _check("--by", abs(given.by), BY_MAX_RAD if known else BY_MAX_UNKNOWN_RAD, "rad")
    _check("--speed", given.speed, SPEED_MAX_RAD_S if known else SPEED_MAX_UNKNOWN_RAD_S, "rad/s")
    limit_nm = Bench(file, robot, given.joint, torque_nm=1.0).limit_nm
    torque_nm = TORQUE_SHARE * limit_nm if given.torque is None else given.torque
    _check("--torque", torque_nm, (TORQUE_SHARE_MAX if known else TORQUE_SHARE) * limit_nm, f"Nm for {given.joint}")
    bench = Bench(file, robot, given.joint, torque_nm=torque_nm, calibrated=known)
    require_watchdog(bench, given.without_watchdog)
    with bench:
        start = bench.read()
        target_rad = start.pos_rad + given.by
        where = _inside(bench, start.pos_rad, target_rad) if known else UNKNOWN
        what = f"{given.joint} {where} and will be turned by {given.by:+.3f} rad at "
        consent(given.joint, f"{what}{given.speed:g} rad/s with at most {torque_nm:.1f} Nm. Keep clear.", ask)
        bench.switch_on()
        end = move(bench, start.pos_rad, target_rad, given.speed)
    print(_verdict(given.joint, given.by, end.pos_rad - start.pos_rad))
    return DONE


def _inside(bench: Bench, start_rad: float, target_rad: float) -> str:
    """Where the joint is. Raises InputError where the target leaves its range."""
    lower, upper = bench.range_rad
    if not lower <= target_rad <= upper:
        expected = f"within {lower:.3f} to {upper:.3f} rad"
        raise InputError("target", where=bench.joint, got=f"{target_rad:.3f} rad", expected=expected)
    return f"is at {start_rad:+.3f} rad"


def move(bench: Bench, start_rad: float, target_rad: float, speed_rad_s: float) -> JointReading:
    """Along a straight ramp, then half a second at its end."""
    way_rad = target_rad - start_rad
    rounds = math.ceil(abs(way_rad) / (speed_rad_s * bench.period_s))
    for tick in range(1, rounds + 1):
        bench.drive(start_rad + way_rad * tick / rounds)
    for _ in range(math.ceil(HOLD_S / bench.period_s)):
        reading = bench.drive(target_rad)
    return reading


def require_watchdog(bench: Bench, waived: bool) -> None:
    """A servo without one goes on pulling if this program is killed. Raises InputError unless that is waived."""
    if not bench.has_watchdog and not waived:
        hint = "move the joint by hand, or say --without-watchdog and keep the power switch in reach"
        raise InputError("its servo has no watchdog that can be set", where=bench.joint, hint=hint)


def _verdict(joint: str, asked_rad: float, moved_rad: float) -> str:
    if abs(moved_rad) < MOVED_SHARE * abs(asked_rad):
        return f"{joint} moved by {moved_rad:+.3f} rad: too little torque (--torque), or something holds it"
    return (
        f"{joint} moved by {moved_rad:+.3f} rad. If another joint moved, ids are exchanged; if it turned against the "
        "joint's positive sense, change the sign of `direction` and zero it anew"
    )


def _check(what: str, value: float, limit: float, unit: str) -> None:
    if not 0 < value <= limit:
        raise InputError(what, got=f"{value:g}", expected=f"above 0 and at most {limit:g} {unit}")


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="hal/jog",
        description="Turn one joint a little with low torque; asks before it moves.",
        epilog="Exit codes: 0 done or stopped, 2 bad input or not agreed, 4 device.",
        allow_abbrev=False,
    )
    parser.add_argument("joint")
    add_wire_options(parser)
    parser.add_argument("--by", type=float, default=0.1, metavar="RAD", help=f"at most {BY_MAX_RAD:g}, either sign")
    parser.add_argument(
        "--from-here",
        action="store_true",
        help=f"its zero is not known yet: its range is not minded, and it turns by {BY_MAX_UNKNOWN_RAD:g} rad at most",
    )
    parser.add_argument("--speed", type=float, default=0.2, metavar="RAD/S")
    parser.add_argument("--torque", type=float, metavar="NM", help="the most it may pull; 5 %% of the joint's limit")
    parser.add_argument("--without-watchdog", action="store_true", help="the servo has none, and you stand by")
    return parser
