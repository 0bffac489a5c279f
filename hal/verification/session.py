"""The whole check, step by step: upright, two leans, every joint. The first thing that is wrong ends it."""

from collections.abc import Callable

from core.clock import Clock
from hal.contract.backend import Backend
from hal.contract.types import DeviceFault, RobotState
from hal.verification.gentle import GentleMover
from hal.verification.leaning import AXES, lean_problem, lean_rad, upright_problem
from hal.verification.operator import AS_SAID, NOTHING, OTHER_ANGLE, OTHER_WAY, Moved, Terminal
from hal.verification.options import VerifyOptions
from hal.verification.senses import sense_of
from robot.robot import Robot


class Mismatch(DeviceFault):
    """The robot is not the one that its files describe."""


def verify(backend: Backend, robot: Robot, clock: Clock, operator: Terminal, options: VerifyOptions) -> None:
    """Check an open backend whose robot hangs upright, its feet off the ground. Leaves it damped.

    Raises Mismatch naming joint or IMU and what is wrong with it, InputError where the operator does not agree,
    DeviceError from the backend.
    """
    operator.ready(
        f"{robot.name} hangs upright on its gantry, feet off the ground. First you lean it, while nothing is energised."
    )
    verify_imu(backend, clock, operator, options)
    operator.ready(
        f"Nobody in reach. It will be energised: damped first, then each joint moved by {options.by_rad:g} rad with at"
        f" most {options.torque_share:.0%} of its torque."
    )
    verify_joints(backend, robot, clock, operator, options)


def verify_imu(backend: Backend, clock: Clock, operator: Terminal, options: VerifyOptions) -> None:
    """Upright, then leaning forwards and to the left; nothing is commanded. Raises as `verify`."""
    _require(upright_problem(_until_still(backend, clock, options, lambda state: True), options))
    for direction in AXES:
        _check_lean(backend, clock, operator, direction, options)


def verify_joints(backend: Backend, robot: Robot, clock: Clock, operator: Terminal, options: VerifyOptions) -> None:
    """Every joint, one after the other. Raises as `verify`."""
    backend.damp()
    operator.ready("The joints resist when they are moved by hand.")
    mover = GentleMover(backend, robot, clock, options)
    for index in range(robot.num_joints):
        moved = _move(mover, robot, index, operator)
        _require(joint_problem(moved, operator.saw(moved)))


def _move(mover: GentleMover, robot: Robot, index: int, operator: Terminal) -> Moved:
    """Turn one joint, up if it can be."""
    joint = robot.joint_names[index]
    for sign in mover.signs(index):
        mover.rest()
        operator.watch(joint)
        if (state := mover.turn(index, sign)) is not None:
            sense = sense_of(robot, joint, state.joint_pos_rad, sign)
            return Moved(joint, float(state.joint_pos_rad[index]), sense)
    raise Mismatch(f"{joint}: turns neither way: something holds it, or its torque_share is too small for its load")


def joint_problem(moved: Moved, answer: str) -> str | None:
    """What an answer means; None where all is well."""
    match answer:
        case answer if answer in (AS_SAID, moved.joint):
            return None
        case _ if answer == OTHER_WAY:
            return f"{moved.joint}: turns the other way: change the sign of its `direction`, then zero it anew"
        case _ if answer == NOTHING:
            return f"{moved.joint}: nothing was seen to move: its values come from elsewhere"
        case _ if answer == OTHER_ANGLE:
            return f"{moved.joint}: does not stand at {moved.pos_rad:+.2f} rad: its zero is not the file's"
        case _:
            return f"{moved.joint}: {answer} moved instead: ids, buses or ports are exchanged"


def _check_lean(backend: Backend, clock: Clock, operator: Terminal, direction: str, options: VerifyOptions) -> None:
    """From rest to rest, however long the operator takes."""
    still = max(1, round(options.settle_s / backend.control_period_s))
    before = _until_still(backend, clock, options, lambda state: True)[-still:]
    operator.lean(direction)
    during = _until_still(backend, clock, options, lambda state: lean_rad(before, state) > options.lean_rad)
    _require(lean_problem(direction, before, during, during[-still:], options))
    operator.upright()


def _until_still(
    backend: Backend, clock: Clock, options: VerifyOptions, reached: Callable[[RobotState], bool]
) -> list[RobotState]:
    """One state per period, until the base has been where it should be, and still, for a while. Raises Mismatch."""
    states: list[RobotState] = []
    still_s, period_s, start_s = 0.0, backend.control_period_s, clock.now_s()
    while still_s < options.settle_s:
        clock.sleep_until(start_s + (len(states) + 1) * period_s)
        states.append(backend.read())
        still = reached(states[-1]) and abs(states[-1].imu_ang_vel_b).max() < options.still_rad_s
        still_s = still_s + period_s if still else 0.0
        if len(states) * period_s > options.lean_wait_s:
            raise Mismatch(f"imu: shows no lean of {options.lean_rad:g} rad, or never comes to rest")
    return states


def _require(problem: str | None) -> None:
    if problem is not None:
        raise Mismatch(problem)
