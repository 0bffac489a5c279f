"""A battery that runs empty: foreseen by what devices report of it, so that a run ends in order before it does."""

from deploy.safety.settings import BatteryLevel, BatterySettings
from hal.contract.types import RobotState


def shortage(state: RobotState, level: BatteryLevel) -> str | None:
    """What is below a level, in one line; None for nothing, and where nothing is reported (nan)."""
    if state.charge < level.charge:
        return f"the battery is at {100.0 * state.charge:.0f} %, limit {100.0 * level.charge:.0f} %"
    if state.supply < level.supply:
        return f"the supply is at {100.0 * state.supply:.0f} % of its voltage, limit {100.0 * level.supply:.0f} %"
    return None


class Lasting:
    """A shortage that has lasted: a hard movement pulls the voltage down for a moment."""

    def __init__(self, level: BatteryLevel, lasts_s: float) -> None:
        self._level, self._lasts_s = level, lasts_s
        self._since_s: float | None = None

    def look(self, state: RobotState) -> str | None:
        """The shortage of this state, where there has been one for so long."""
        found = shortage(state, self._level)
        if found is None:
            self._since_s = None
            return None
        self._since_s = state.time_s if self._since_s is None else self._since_s
        return found if state.time_s - self._since_s >= self._lasts_s else None


class Battery:
    """See Forecast. It never trips: an empty battery is no reason to let a robot fall that still stands."""

    def __init__(self, settings: BatterySettings) -> None:
        self.warning: str | None = None
        self.urgent = False
        self._warn, self._lower = Lasting(settings.warn, settings.lasts_s), Lasting(settings.lower, settings.lasts_s)

    def look(self, state: RobotState) -> None:
        """One tick."""
        low, lowest = self._warn.look(state), self._lower.look(state)
        self.warning, self.urgent = lowest or low, lowest is not None
