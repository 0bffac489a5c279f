"""Conversations with one servo: find and check it, switch it on and off. All raise DeviceError saying what is wrong."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from core import robot_time as time
from hal.can.bus import CanBus
from hal.can.codec import WATCHDOG_S, ZERO_MARK, CommandKind, MotorCommand
from hal.can.frame import Frame
from hal.can.messages import Feedback, Identity, Message, Parameter
from hal.can.motor import Motor
from hal.can.talk import ask, listen
from hal.can.torque_check import TorqueCheck
from hal.can.zero_mark import require_mark
from hal.contract.types import DeviceError, DeviceFault

SWITCH_TRIES = 10
SWITCH_OFF_S, AGAIN_S = 0.5, 0.05
ANSWER_TRIES = 6
IDENTITY_TRIES = 2
WATCHDOG_TOLERANCE = 0.02
LISTEN_S = 0.05
COMMANDING = (CommandKind.CONTROL, CommandKind.GAINS, CommandKind.ENABLE)


def commanded_by_others(bus: CanBus) -> list[str]:
    """The joints whose motors somebody else commands: what is on the wire though we have said nothing yet."""
    heard = listen(bus, LISTEN_S)
    names = []
    for motor in bus.motors:
        commands = (motor.codec.parse_command(frame, MotorCommand()) for frame in heard)
        if any(command is not None and command.kind in COMMANDING for command in commands):
            names.append(motor.joint)
    return names


def prepare(bus: CanBus, motor: Motor, watchdog_s: float, *, calibrated: bool = True) -> None:
    """Watchdog set and read back, scaling read or compared, zero known, position inside the joint's band, which the
    motor's range holds; its serial number, where it has one. Energises nothing.

    calibrated: False where zero and band say nothing yet. Raises DeviceError where the motor is silent, DeviceFault
    where what it says cannot be used.
    """
    _set_watchdog(bus, motor, watchdog_s)
    asked = zip(motor.codec.setup_names, motor.codec.read_setup())
    parameters = {name: _parameter(bus, motor, name, question) for name, question in asked}
    with _naming(motor):
        motor.codec = motor.codec.with_setup(parameters)
    state = _state(bus, motor)
    with _naming(motor):
        motor.codec.check_feedback(parameters, state)
    if calibrated:
        require_mark(bus, motor, parameters.get(ZERO_MARK))
        bus.settle_turns(motor)
        _check_reach(bus, motor)
    answer = ask(
        bus, motor, motor.codec.ask_identity(), lambda message: isinstance(message, Identity), tries=IDENTITY_TRIES
    )
    motor.serial = answer.serial if isinstance(answer, Identity) else ""


def switch_on(bus: CanBus, motor: Motor, *, calibrated: bool = True) -> None:
    """Clear what its watchdog left, enable it, into damping. Refuses a joint outside its band."""
    if calibrated and not bus.is_in_band(motor):
        raise DeviceFault(f"{motor.name}: at {bus.joint_pos_rad(motor):.3f} rad, outside its range: move it by hand")
    if motor.codec.watchdog_fault is not None and motor.codec.watchdog_fault in motor.faults:
        ask(bus, motor, motor.codec.clear_fault(), _is_feedback, tries=1)
    frames = (*motor.codec.enable(), *motor.codec.damping(motor.damping_kd))
    motor.torque_check = TorqueCheck(min(motor.limit_nm, motor.codec.model.torque_nm))
    motor.enabled = motor.switching = True
    try:
        motor.enabled = ask(bus, motor, frames, _says_on, tries=SWITCH_TRIES) is not None
    finally:
        motor.switching = False
    if not motor.enabled:
        faults = ", ".join(motor.faults) or "no fault shown"
        raise DeviceError(f"{motor.name}: does not switch on ({faults})")


def switch_off(bus: CanBus, motors: Sequence[Motor]) -> None:
    """Take the drive away from all of them, again and again for half a second, until each has confirmed it: a lost
    frame must not leave a motor on, and a silent motor must not keep the others. Raises DeviceError naming the rest."""
    end_s = time.monotonic() + SWITCH_OFF_S
    waiting = list(motors)
    for motor in waiting:
        motor.enabled = False
    while waiting and (now_s := time.monotonic()) < end_s:
        with bus.lock:
            for motor in waiting:
                motor.inbox.clear()
                motor.unanswered.restart(now_s)
            bus.link.send([frame for motor in waiting for frame in motor.codec.disable()])
            until_s = min(end_s, now_s + AGAIN_S)
            while waiting and (frame := bus.link.receive(until_s)) is not None:
                bus.take(frame, now_s)
                waiting = [motor for motor in waiting if not any(map(partial(_says_off, motor), motor.inbox))]
    if waiting:
        names = ", ".join(motor.name for motor in waiting)
        raise DeviceError(f"bus {bus.name}: has not confirmed within {SWITCH_OFF_S:g} s that it is off: {names}")


def bring_back(bus: CanBus, motor: Motor, watchdog_s: float, *, on: bool) -> None:
    """The operator's word after a fault: clear it, check everything anew, switch on into damping where it was on."""
    motor.enabled, motor.torque_check = False, None
    ask(bus, motor, motor.codec.clear_fault(), _is_feedback, tries=ANSWER_TRIES)
    prepare(bus, motor, watchdog_s)
    faults = [name for name in motor.faults if name != motor.codec.watchdog_fault]
    if faults:
        raise DeviceFault(f"{motor.name}: still reports {', '.join(faults)}")
    if on:
        switch_on(bus, motor)
    bus.forget(motor)


@contextlib.contextmanager
def _naming(motor: Motor) -> Iterator[None]:
    """A codec knows no joint."""
    try:
        yield
    except DeviceFault as error:
        raise DeviceFault(f"{motor.joint}: {error}") from error


def _check_reach(bus: CanBus, motor: Motor) -> None:
    """Refuse a joint's band that leaves the range of the motor's positions: a target would be cut off silently."""
    row = [motor.row]
    ends_rad = [float(bus.map.take(row).raw_rad(band[row])[0]) for band in bus.bands]
    most_rad = motor.codec.model.pos_rad
    if max(map(abs, ends_rad)) > most_rad:
        raise DeviceFault(
            f"{motor.name}: its joint's band is {min(ends_rad):.3f} to {max(ends_rad):.3f} rad at the motor, whose"
            f" positions end at {most_rad:g} rad: raise its range (Damiao: register 21), or set its zero nearer"
        )


def _set_watchdog(bus: CanBus, motor: Motor, watchdog_s: float) -> None:
    if not motor.codec.has_watchdog:
        return
    frames = (*motor.codec.set_watchdog(watchdog_s), *motor.codec.read_watchdog())
    answer = ask(bus, motor, frames, _names(WATCHDOG_S), tries=ANSWER_TRIES)
    if not isinstance(answer, Parameter):
        raise _silent(bus, motor)
    if abs(answer.value - watchdog_s) > WATCHDOG_TOLERANCE * watchdog_s:
        raise DeviceFault(f"{motor.name}: its watchdog reads {answer.value:g} s after setting {watchdog_s:g} s")


def _parameter(bus: CanBus, motor: Motor, name: str, question: Frame) -> float:
    answer = ask(bus, motor, (question,), _names(name), tries=ANSWER_TRIES)
    if not isinstance(answer, Parameter):
        raise DeviceError(f"{motor.name}: does not say its {name}")
    return answer.value


def _state(bus: CanBus, motor: Motor) -> Feedback:
    """A complete state, be it in several frames."""
    patience_s = 3.0 * (motor.codec.cyclic_period_s or 0.0)
    motor.forget_state()
    ask(bus, motor, motor.codec.request_state(), lambda _: motor.complete, tries=ANSWER_TRIES, patience_s=patience_s)
    if not motor.complete:
        raise _silent(bus, motor)
    return Feedback(motor.codec.motor_id, motor.pos_rad, motor.vel_rad_s, motor.torque_nm)


def _silent(bus: CanBus, motor: Motor) -> DeviceError:
    return DeviceError(f"{motor.name}: silent on bus {bus.name}: no power, no cable, or another id")


def _names(name: str) -> Callable[[Message], bool]:
    return lambda message: isinstance(message, Parameter) and message.name == name


def _is_feedback(message: Message) -> bool:
    return isinstance(message, Feedback)


def _says_on(message: Message) -> bool:
    """Motors that never say whether they are on are believed when they answer."""
    return isinstance(message, Feedback) and message.enabled is not False and message.pos_rad is not None


def _says_off(motor: Motor, message: Message) -> bool:
    """Likewise; but of one that speaks unasked only the word counts."""
    if not isinstance(message, Feedback):
        return False
    return message.enabled is False or (message.enabled is None and motor.codec.cyclic_period_s is None)
