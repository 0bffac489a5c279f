"""What a motor says, whatever its protocol. Values are the motor's own: rad, rad/s, Nm at its shaft."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Feedback:
    """What one frame says of a motor; None where this frame does not carry the value.

    faults: names that are present now; None where the frame says nothing of faults. enabled: the drive is on.
    """

    motor_id: int
    pos_rad: float | None = None
    vel_rad_s: float | None = None
    torque_nm: float | None = None
    temperature_c: float | None = None
    faults: tuple[str, ...] | None = None
    enabled: bool | None = None
    supply_v: float | None = None


@dataclass(frozen=True, slots=True)
class Parameter:
    """The motor's answer to a read. name: `WATCHDOG_S`, `CONTROL_MODE`, `SUPPLY_V`, or one of `setup_names`."""

    motor_id: int
    name: str
    value: float


@dataclass(frozen=True, slots=True)
class Ack:
    """The motor acknowledged something that is not state. ok: False where it refused."""

    motor_id: int
    what: str
    ok: bool = True


@dataclass(frozen=True, slots=True)
class Identity:
    """Who the motor is: the number that its maker gave this one alone, in hexadecimal digits."""

    motor_id: int
    serial: str


Message = Feedback | Parameter | Ack | Identity
