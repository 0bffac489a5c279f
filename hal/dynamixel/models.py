"""What is true of each Dynamixel model, and the law by which it turns counts into torque."""

import dataclasses
import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from core.config import load_options
from core.structured import one_of
from hal.dynamixel import registers as r

P_UNIT, D_UNIT = 1 / 128, 1 / 16
PWM_FULL = 885
LOAD_FULL = 1000


@dataclass(frozen=True)
class Model:
    """One model, at the supply `at_v`. See models.yaml."""

    name: str
    number: int
    stall_nm: float
    stall_a: float
    no_load_rpm: float
    at_v: float
    current_unit_a: float | None
    current_max: int
    fast_firmware: int | None
    baud_max: int

    @property
    def has_current(self) -> bool:
        """Whether it senses its current, and so has the current-based position mode."""
        return self.current_unit_a is not None

    @property
    def operating_mode(self) -> int:
        """The mode that is used: current-based position where the model has it, else extended position."""
        return r.MODE_CURRENT_POSITION if self.has_current else r.MODE_EXTENDED

    def stand_in(self, name: str, stall_nm: float, no_load_rad_s: float) -> "Model":
        """The same electronics with another strength and speed."""
        rpm = no_load_rad_s * 60 / (2 * math.pi)
        return dataclasses.replace(self, name=name, stall_nm=stall_nm, no_load_rpm=rpm)


@dataclass(frozen=True)
class _File:
    control_period_s: float
    models: tuple[Model, ...]


@functools.cache
def _file() -> _File:
    return load_options(_File, Path(__file__).with_name("models.yaml"))


def known_models() -> dict[str, Model]:
    """All models by name."""
    return {model.name: model for model in _file().models}


def find_model(name: str) -> Model:
    """Raises InputError on an unknown name."""
    models = known_models()
    one_of(None, name, models, "unknown Dynamixel model")
    return models[name]


class Law:
    """How N servos turn gains in counts into torque, at the horn, in SI units. Arrays (N,).

    Current-based position mode (maker's manual, "Position PID gain": the controller puts out a target current, which
    the goal current limits):

        torque = nm_per_count (P/128 e - D/16 T v),  e, v in counts and counts/s, T the servo's control period.

    Extended position mode puts out a duty cycle instead, so that the motor's back-EMF brakes besides:

        torque = stall (P/128 e - D/16 T v) / 885 - stall/no_load v,  stall proportional to the supply.

    kp_unit, kd_unit: stiffness and damping of one count of P and D. kd_own: damping at D = 0.
    torque_unit: Nm of one count of present current (or load). limit_max: highest torque that can be asked for.
    """

    def __init__(self, models: list[Model], supply_v: float) -> None:
        stall_nm = np.array([model.stall_nm * supply_v / model.at_v for model in models])
        no_load_rad_s = np.array([model.no_load_rpm * 2 * math.pi / 60 * supply_v / model.at_v for model in models])
        self.has_current = np.array([model.has_current for model in models])
        per_current = np.array([(m.current_unit_a or 0.0) * m.stall_nm / m.stall_a for m in models])
        output_nm = np.where(self.has_current, per_current, stall_nm / PWM_FULL)
        self.kp_unit = output_nm * P_UNIT * r.COUNTS_PER_RAD
        self.kd_unit = output_nm * D_UNIT * r.COUNTS_PER_RAD * _file().control_period_s
        self.kd_own = np.where(self.has_current, 0.0, stall_nm / no_load_rad_s)
        self.torque_unit = np.where(self.has_current, per_current, stall_nm / LOAD_FULL)
        self.current_max = np.array([model.current_max for model in models])
        self.limit_max = np.where(self.has_current, np.minimum(self.current_max * per_current, stall_nm), stall_nm)
        self._per_current = per_current

    def p_counts(self, kp: np.ndarray) -> np.ndarray:
        """P (N,) for a stiffness in Nm/rad, rounded, within the register's range."""
        return np.clip(np.rint(kp / self.kp_unit), 0, r.GAIN_MAX).astype(int)

    def d_counts(self, kd: np.ndarray) -> np.ndarray:
        """D (N,) for a damping in Nm s/rad, what the motor brings by itself taken off."""
        return np.clip(np.rint((kd - self.kd_own) / self.kd_unit), 0, r.GAIN_MAX).astype(int)

    def kp(self, p: np.ndarray) -> np.ndarray:
        """Stiffness of P."""
        return p * self.kp_unit

    def kd(self, d: np.ndarray) -> np.ndarray:
        """Damping of D, the motor's own included."""
        return d * self.kd_unit + self.kd_own

    def current_counts(self, torque_nm: np.ndarray) -> np.ndarray:
        """Goal current (N,) that limits the torque; 0 for servos without current."""
        counts = np.divide(torque_nm, self._per_current, out=np.zeros(len(torque_nm)), where=self.has_current)
        return np.minimum(np.rint(counts), self.current_max).astype(int)
