"""Physical values as unsigned integers of n bits, and the frame layout that three vendors share.

Layout of the MIT command, a big-endian bit string: position 16, velocity 12, kp 12, kd 12, torque 12. Of the state:
position 16, velocity 12, torque 12. A range's ends are the codes 0 and 2^n - 1: a divisor of 2^n would send the upper
end as the lower one.
"""

from hal.can.codec import MotorCommand, MotorModel

SPECIAL_FRAMES = 0xFFFF_FFFF_FFFF_FF00
VELOCITY_STEP = 1 << 36


def to_code(value: float, lower: float, upper: float, bits: int) -> int:
    """The nearest code of a finite value; values outside the range go to its end."""
    full = (1 << bits) - 1
    code = round((value - lower) / (upper - lower) * full)
    return min(max(code, 0), full)


def from_code(code: int, lower: float, upper: float, bits: int) -> float:
    """The value that a code stands for."""
    return code * (upper - lower) / ((1 << bits) - 1) + lower


def pack_mit_command(target: MotorCommand, model: MotorModel) -> bytes:
    """8 bytes. Never one of the special frames (FF seven times), which the highest values would otherwise spell.

    kd stays at least one step above 0 where it was asked to be above 0.
    """
    kd = to_code(target.kd, 0.0, model.kd, 12)
    if kd == 0 and target.kd > 0:
        kd = 1
    word = (
        to_code(target.q_rad, -model.pos_rad, model.pos_rad, 16) << 48
        | to_code(target.dq_rad_s, -model.vel_rad_s, model.vel_rad_s, 12) << 36
        | to_code(target.kp, 0.0, model.kp, 12) << 24
        | kd << 12
        | to_code(target.tau_nm, -model.torque_nm, model.torque_nm, 12)
    )
    if word >= SPECIAL_FRAMES:
        word -= VELOCITY_STEP
    return word.to_bytes(8, "big")


def unpack_mit_command(data: bytes, model: MotorModel) -> MotorCommand:
    """What a motor reads in 8 bytes."""
    word = int.from_bytes(data, "big")
    return MotorCommand(
        q_rad=from_code(word >> 48, -model.pos_rad, model.pos_rad, 16),
        dq_rad_s=from_code(word >> 36 & 0xFFF, -model.vel_rad_s, model.vel_rad_s, 12),
        kp=from_code(word >> 24 & 0xFFF, 0.0, model.kp, 12),
        kd=from_code(word >> 12 & 0xFFF, 0.0, model.kd, 12),
        tau_nm=from_code(word & 0xFFF, -model.torque_nm, model.torque_nm, 12),
    )


def pack_mit_state(pos_rad: float, vel_rad_s: float, torque_nm: float, model: MotorModel) -> bytes:
    """5 bytes: position, velocity, torque."""
    word = (
        to_code(pos_rad, -model.pos_rad, model.pos_rad, 16) << 24
        | to_code(vel_rad_s, -model.vel_rad_s, model.vel_rad_s, 12) << 12
        | to_code(torque_nm, -model.torque_nm, model.torque_nm, 12)
    )
    return word.to_bytes(5, "big")


def unpack_mit_state(data: bytes, model: MotorModel) -> tuple[float, float, float]:
    """Position (rad), velocity (rad/s), torque (Nm) from 5 bytes."""
    word = int.from_bytes(data, "big")
    return (
        from_code(word >> 24, -model.pos_rad, model.pos_rad, 16),
        from_code(word >> 12 & 0xFFF, -model.vel_rad_s, model.vel_rad_s, 12),
        from_code(word & 0xFFF, -model.torque_nm, model.torque_nm, 12),
    )
