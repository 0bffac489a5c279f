"""How warm motors are inside: winding and housing from the torque that they give."""

import math
from dataclasses import dataclass

import numpy as np

from core.errors import InputError
from core.structured import positive

FOREVER_S = math.inf


@dataclass(frozen=True)
class ThermalFigures:
    """Of every motor, whose copper losses grow with the square of its torque.

    winding_k: by how much the winding is warmer than the housing, and housing_k the housing than the air, if the
    torque limit were held for ever: thermal resistance times losses. winding_s, housing_s: their time constants.
    """

    ambient_c: float
    limit_c: float
    winding_k: float
    housing_k: float
    winding_s: float
    housing_s: float

    def __post_init__(self) -> None:
        for name in ("winding_k", "housing_k", "winding_s", "housing_s"):
            positive(name, getattr(self, name))
        if not self.ambient_c < self.limit_c:
            raise InputError(
                "too low", where="limit_c", got=self.limit_c, expected=f"above ambient, {self.ambient_c} °C"
            )


class MotorHeat:
    """Two first-order elements in series, solved exactly for a load that stays the same during a step. Arrays (J,)."""

    def __init__(self, torque_limit_nm: np.ndarray, figures: ThermalFigures) -> None:
        self._limit_nm, self._figures = torque_limit_nm, figures
        self._load = np.zeros_like(torque_limit_nm)
        self._winding_k = np.zeros_like(torque_limit_nm)
        self._housing_k = np.zeros_like(torque_limit_nm)

    @property
    def winding_c(self) -> np.ndarray:
        """Temperature of the windings."""
        return self.housing_c + self._winding_k

    @property
    def housing_c(self) -> np.ndarray:
        """Temperature of the housings."""
        return self._figures.ambient_c + self._housing_k

    def step(self, torque_nm: np.ndarray, lasting_s: float, housing_c: np.ndarray | None = None) -> None:
        """A torque (J,) is held for a time. housing_c: measured, put in the place of the model's where it is known."""
        f, load = self._figures, (torque_nm / self._limit_nm) ** 2
        kept = math.exp(-lasting_s / f.winding_s)
        self._winding_k = f.winding_k * load + (self._winding_k - f.winding_k * load) * kept
        self._load = load + (self._load - load) * kept
        rise_k = f.housing_k * load
        self._housing_k = rise_k + (self._housing_k - rise_k) * math.exp(-lasting_s / f.housing_s)
        if housing_c is not None:
            self._housing_k = np.where(np.isfinite(housing_c), housing_c - f.ambient_c, self._housing_k)

    def left_s(self, limit_c: float) -> np.ndarray:
        """How long (J,) the mean load of late may go on before the winding is so warm; inf: for ever."""
        f = self._figures
        room_k = limit_c - f.ambient_c - np.maximum(self._winding_k, f.winding_k * self._load)
        rise_k = f.housing_k * self._load
        heats = (rise_k > room_k) & (rise_k > self._housing_k)
        share = np.where(heats, (rise_k - self._housing_k) / np.where(heats, rise_k - room_k, 1.0), 1.0)
        left_s = f.housing_s * np.log(np.maximum(share, 1.0))
        return np.where(self._housing_k >= room_k, 0.0, np.where(heats, left_s, FOREVER_S))
