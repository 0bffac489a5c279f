"""The command `hal/zero_dynamixel`: find one joint's `zero_rad`, the joint being held by hand. Nothing is energised."""

import contextlib
from collections.abc import Sequence

import numpy as np

from core.arguments import ArgumentParser
from core.command import STOPPED
from core.errors import InputError
from hal.calibration.consent import Ask, consent, endpoints_of, run_command
from hal.calibration.zero import settle, zero_of
from hal.contract.types import DeviceError
from hal.dynamixel import registers as r
from hal.dynamixel import setup
from hal.dynamixel.port import ServoPort
from hal.dynamixel.robot_file import DynamixelOptions, ServoOptions, load_dynamixel, with_endpoints
from hal.dynamixel.setup import Servo
from hal.wire.lock import WireLock, wire_name
from robot.robot import load_robot

LISTEN_S = 0.3
READINGS = 20
STILL_RAD = 0.01


def main(arguments: Sequence[str] | None = None, *, ask: Ask | None = None) -> int:
    """Returns 0 done, 130 stopped, 2 bad input or not agreed, 4 device."""
    return run_command(lambda: _zero(arguments, ask), STOPPED)


def _zero(arguments: Sequence[str] | None, ask: Ask | None) -> int:
    given = _parser().parse_args(arguments)
    options, robot = with_endpoints(load_dynamixel(given.config), endpoints_of(given.at)), load_robot(given.robot)
    servo = _servo(options, given.joint)
    if given.joint not in robot.joint_names:
        raise InputError("--robot", got=given.robot, expected=f"a robot with the joint {given.joint}")
    row = robot.joint_names.index(given.joint)
    lower, upper = float(robot.pos_lower_rad[row]), float(robot.pos_upper_rad[row])
    if not lower <= given.angle <= upper:
        raise InputError("--angle", got=given.angle, expected=f"within {lower:g} to {upper:g} rad")
    raw_rad = held_rad(options, servo, f"Hold {given.joint} at {given.angle:+.4f} rad and keep it still.", ask)
    zero_rad = zero_of(servo, raw_rad, given.angle)
    return settle(given.config, given.joint, servo.zero_rad, zero_rad, write=given.write, ask=ask)


def held_rad(options: DynamixelOptions, servo: ServoOptions, what: str, ask: Ask | None) -> float:
    """The servo's angle while somebody holds it, the mean of 20 readings; 0 is the middle of its turn.

    Raises DeviceError where another program commands the port, where the servo is silent or not as the file says, where
    its torque is on, or where the joint moves.
    """
    (entry,) = [port for port in options.ports if port.name == servo.port]
    with (
        WireLock((wire_name("serial", entry.device),)),
        contextlib.closing(ServoPort(entry.device, entry.baud)) as port,
    ):
        port.open()
        if port.hears_strangers(LISTEN_S):
            raise DeviceError(f"{entry.device}: somebody else commands its servos")
        expected = Servo(servo.joint, servo.id, options.model(servo), False, options.supply_v, 0, 0, 0)
        _, problems = setup.run(setup.find(port, expected))
        if problems:
            raise DeviceError("; ".join(problems))
        consent(servo.joint, f"{servo.joint} is slack. {what}", ask)
        counts = [setup.run(setup.get(port, servo.id, r.PRESENT_POSITION)) for _ in range(READINGS)]
    moved_rad = float(np.ptp(counts)) / r.COUNTS_PER_RAD
    if moved_rad > STILL_RAD * servo.gear:
        raise DeviceError(f"{servo.joint}: moves by {moved_rad:.3f} rad while it is read: hold it still")
    return (float(np.mean(counts)) - r.CENTRE) / r.COUNTS_PER_RAD


def _servo(options: DynamixelOptions, joint: str) -> ServoOptions:
    for servo in options.servos:
        if servo.joint == joint:
            return servo
    names = ", ".join(servo.joint for servo in options.servos)
    raise InputError("unknown joint", got=joint, expected=f"one of {names}")


def _parser() -> ArgumentParser:
    parser = ArgumentParser(
        prog="hal/zero_dynamixel",
        description="Find the zero of one joint of Dynamixel servos: hold it at a known angle by hand.",
        epilog="Exit codes: 0 done, 2 bad input or not agreed, 4 device, 130 stopped.",
        allow_abbrev=False,
    )
    parser.add_argument("joint")
    parser.add_argument("--config", default="dynamixel_g1", metavar="NAME|FILE", help="the file, see configs/hal")
    parser.add_argument("--robot", default="g1_23dof", metavar="NAME|FILE", help="see configs/robot")
    parser.add_argument("--at", action="append", default=[], metavar="PORT=DEVICE", help="a port elsewhere; repeatable")
    parser.add_argument("--angle", type=float, default=0.0, metavar="RAD", help="where you hold it")
    parser.add_argument("--write", action="store_true", help="change the file, after asking")
    return parser
