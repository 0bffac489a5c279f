"""A battery that runs empty, or a supply that leaves its range, by what devices report: a run ends in order before."""

from deploy.safety.settings import BatteryLevel, BatterySettings
from hal.contract.types import RobotState


def shortage(state: RobotState, level: BatteryLevel) -> str | None:
    """What is below a level, in one line; None for nothing, and where nothing is reported (nan)."""
    if state.charge < level.charge:
        return f"the battery is at {100.0 * state.charge:.0f} %, limit {100.0 * level.charge:.0f} %"
    return _off(state.supply, level.supply[0]) if state.supply < level.supply[0] else None


def excess(state: RobotState, level: BatteryLevel) -> str | None:
    """Likewise what is above it."""
    return _off(state.supply_high, level.supply[1]) if state.supply_high > level.supply[1] else None


def _off(share: float, limit: float) -> str:
    return f"the supply is at {100.0 * share:.0f} % of its voltage, limit {100.0 * limit:.0f} %"


class Lasting:
    """What has lasted: a hard movement pulls the voltage down for a moment, one that is braked pushes it up."""

    def __init__(self, level: BatteryLevel, lasts_s: float) -> None:
        self._level, self._lasts_s = level, lasts_s
        self._since_s: float | None = None

    def look(self, state: RobotState) -> str | None:
        """The shortage or excess of this state, where there has been one for so long."""
        found = shortage(state, self._level) or excess(state, self._level)
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
