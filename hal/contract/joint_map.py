"""Between what a motor says of its shaft and what the robot calls its joint.

One law for every servo: q = direction (raw - zero) / gear + turns * 2 pi / gear. `turns` is settled once after the
power has come on, because a single-turn encoder may start whole turns away from where it was calibrated. Torque and
gains follow from the same law.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from core.errors import InputError
from hal.contract.types import DeviceFault
from world.actuation import JointCommand

TURN_RAD = 2.0 * math.pi


@dataclass(frozen=True, eq=False)
class JointMap:
    """N motors and the joints that they move, in the motors' order.

    joint_names: one per motor. direction: (N,) +-1, the joint's sense in the motor's. zero_rad: (N,) motor position
    at joint position 0. gear: (N,) motor turns per joint turn, > 0. turns: (N,) whole motor turns that are added.
    All methods take and give (N,) arrays in the motors' order; "raw" is the motor's side.
    """

    joint_names: tuple[str, ...]
    direction: np.ndarray
    zero_rad: np.ndarray
    gear: np.ndarray
    turns: np.ndarray

    @classmethod
    def of(
        cls,
        joint_names: Sequence[str],
        direction: Sequence[float] | np.ndarray,
        zero_rad: Sequence[float] | np.ndarray,
        gear: Sequence[float] | np.ndarray,
    ) -> Self:
        """A map with no turns added. Raises InputError on repeated names and impossible figures, naming the joint."""
        names = tuple(joint_names)
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise InputError("more than one motor", where="joint map", got=", ".join(repeated))
        arrays = [np.array(values, dtype=np.float64) for values in (direction, zero_rad, gear)]
        for what, values in zip(("direction", "zero_rad", "gear"), arrays):
            if values.shape != (len(names),):
                raise ValueError(f"joint map {what}: got shape {values.shape}, expected ({len(names)},)")
            values.flags.writeable = False
        for name, sign, zero, ratio in zip(names, *(values.tolist() for values in arrays)):
            if abs(sign) != 1.0:
                raise InputError("direction", where=name, got=sign, expected="1 or -1")
            if not math.isfinite(zero):
                raise InputError("zero_rad", where=name, got=zero, expected="a finite angle")
            if not 0 < ratio < math.inf:
                raise InputError("gear", where=name, got=ratio, expected="a ratio above 0")
        return cls(names, arrays[0], arrays[1], arrays[2], np.zeros(len(names)))

    def take(self, index: Sequence[int] | np.ndarray) -> Self:
        """The map of some of the motors, in the order given."""
        rows = np.asarray(index, dtype=int)
        arrays = {name: getattr(self, name)[rows] for name in ("direction", "zero_rad", "gear", "turns")}
        return replace(self, joint_names=tuple(self.joint_names[i] for i in rows.tolist()), **arrays)

    @property
    def turn_rad(self) -> np.ndarray:
        """(N,) what one turn of the motor is at the joint."""
        return TURN_RAD / self.gear

    def pos_rad(self, raw_rad: np.ndarray) -> np.ndarray:
        """Joint positions."""
        return self.direction * (raw_rad - self.zero_rad) / self.gear + self.turns * self.turn_rad

    def vel_rad_s(self, raw_rad_s: np.ndarray) -> np.ndarray:
        """Joint speeds."""
        return self.direction * raw_rad_s / self.gear

    def torque_nm(self, raw_nm: np.ndarray) -> np.ndarray:
        """Joint torques, without the gear's losses."""
        return self.direction * raw_nm * self.gear

    def raw_rad(self, pos_rad: np.ndarray) -> np.ndarray:
        """Motor positions for joint positions."""
        return self.direction * (pos_rad - self.turns * self.turn_rad) * self.gear + self.zero_rad

    def raw_rad_s(self, vel_rad_s: np.ndarray) -> np.ndarray:
        """Motor speeds for joint speeds."""
        return self.direction * vel_rad_s * self.gear

    def raw_nm(self, torque_nm: np.ndarray) -> np.ndarray:
        """Motor torques for joint torques."""
        return self.direction * torque_nm / self.gear

    def raw_gain(self, gain: np.ndarray) -> np.ndarray:
        """Motor stiffness or damping for the joint's: torque over angle scales with the gear's square."""
        return gain / (self.gear * self.gear)

    def gain(self, raw_gain: np.ndarray) -> np.ndarray:
        """The joint's stiffness or damping for the motor's."""
        return raw_gain * (self.gear * self.gear)

    def raw_command(self, command: JointCommand, index: np.ndarray) -> JointCommand:
        """What each motor is to be told. index: (N,) where each motor's joint stands in the command."""
        return JointCommand(
            self.raw_rad(command.q_rad[index]),
            self.raw_rad_s(command.dq_rad_s[index]),
            self.raw_gain(command.kp[index]),
            self.raw_gain(command.kd[index]),
            self.raw_nm(command.tau_nm[index]),
        )

    def check_bands(self, lower_rad: np.ndarray, upper_rad: np.ndarray, folded: np.ndarray) -> None:
        """Refuse bands (N,) that hold more than one turn of a motor whose turns are to be settled.

        folded: (N,) bool. Raises InputError naming the joints.
        """
        ambiguous = np.flatnonzero(folded & (upper_rad - lower_rad >= self.turn_rad))
        if ambiguous.size:
            names = ", ".join(self.joint_names[i] for i in ambiguous.tolist())
            raise InputError(
                "the joint's band holds more than one turn of its motor, its position after power-up is ambiguous",
                where=names,
                hint="say `fold: false` where the motor keeps count of its turns, or is zeroed at every power-up",
            )

    def folded(
        self,
        raw_rad: np.ndarray,
        lower_rad: np.ndarray,
        upper_rad: np.ndarray,
        may_fold: np.ndarray | bool = True,
    ) -> Self:
        """The map whose turns put these motor positions into the joints' bands (N,).

        may_fold: (N,) bool; turns stay 0 elsewhere. Raises DeviceFault naming every joint that no whole turn brings
        into its band.
        """
        plain = replace(self, turns=np.zeros(len(self.joint_names)))
        pos_rad = plain.pos_rad(raw_rad)
        turns = np.where(may_fold, _turns_away(pos_rad, lower_rad, upper_rad, self.turn_rad), 0.0)
        found_rad = pos_rad + turns * self.turn_rad
        outside = ~((found_rad >= lower_rad) & (found_rad <= upper_rad))
        if outside.any():
            raise DeviceFault(
                "; ".join(
                    f"{self.joint_names[i]}: at {found_rad[i]:.3f} rad, outside {lower_rad[i]:.3f} to "
                    f"{upper_rad[i]:.3f} rad, whole turns of the motor included"
                    for i in np.flatnonzero(outside).tolist()
                )
            )
        return replace(self, turns=turns)

    def slipped(
        self, pos_rad: np.ndarray, lower_rad: np.ndarray, upper_rad: np.ndarray, may_fold: np.ndarray | bool = True
    ) -> np.ndarray:
        """(N,) bool: joints that read outside their band while some whole turn of the motor would put them inside.

        That is a motor that lost its count (power-cycled, or wrapped round the end of its range).
        """
        if ((pos_rad >= lower_rad) & (pos_rad <= upper_rad)).all():  # as a rule: spare the rest, in every round
            return np.zeros(len(pos_rad), dtype=bool)
        away = _turns_away(pos_rad, lower_rad, upper_rad, self.turn_rad)
        found_rad = pos_rad + away * self.turn_rad
        return may_fold & (away != 0) & (found_rad >= lower_rad) & (found_rad <= upper_rad)


def _turns_away(pos_rad: np.ndarray, lower_rad: np.ndarray, upper_rad: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    """Whole turns that bring positions nearest to the middle of their bands; 0 for those already inside."""
    inside = (pos_rad >= lower_rad) & (pos_rad <= upper_rad)
    finite = np.where(np.isfinite(pos_rad) & ~inside, pos_rad, 0.5 * (lower_rad + upper_rad))
    return np.round((0.5 * (lower_rad + upper_rad) - finite) / turn_rad)
