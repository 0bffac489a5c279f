"""The gate between actor and backend: asks every rule, counts, and alone makes commands."""

import math

import numpy as np

from deploy.safety.battery import Battery
from deploy.safety.health import WindingTemperature
from deploy.safety.limits import SoftPosition, StaleHold, TorqueLimit
from deploy.safety.plausible import Plausibility
from deploy.safety.rules import Fault, Forecast, LimitRule, Sample, Tally, TripRule, Wish
from deploy.safety.trips import CLOCK_GRAIN_S, ticks_of, trip_rules
from deploy.settings import DeploySettings
from hal.contract.types import DeviceError, DeviceFault, RobotState
from policy.controller import PolicyOutput
from robot.robot import Robot
from world.actuation import JointCommand

STAND_UP_RULES = ("not_energised", "not_at_rest", "stand_up_error", "stand_up_lag", "stand_up_tilt")
OTHER_RULES = ("action_not_finite", "link_loss", *STAND_UP_RULES)


class Guard:
    """All safety rules of one run.

    report_only: rules (a) torque_limit and (b) soft_position count but do not act; for simulation only.
    counts: ticks on which each rule was violated or acted, by rule name. winding: the heat of the motors; None where
    the robot has no figures of it.
    """

    def __init__(self, robot: Robot, settings: DeploySettings, period_s: float, *, report_only: bool = False) -> None:
        safety = settings.safety
        self._gate = Plausibility(robot, safety.implausible, period_s, ticks_of(safety.implausible.for_s, period_s))
        self._late_hold = StaleHold(safety.stale.limit_periods * period_s - CLOCK_GRAIN_S, self._gate)
        self._limits: tuple[LimitRule, ...] = (
            self._late_hold,
            SoftPosition(robot, safety.soft_position.factor, report_only),
            TorqueLimit(robot, safety.torque_limit.factor, report_only),
        )
        self._trips: tuple[TripRule, ...] = trip_rules(robot, safety, period_s, self._gate)
        self._battery = Battery(safety.battery)
        self.winding = next((rule for rule in self._trips if isinstance(rule, WindingTemperature)), None)
        self._forecasts: tuple[Forecast, ...] = (*([self.winding] if self.winding else []), self._battery)
        self._tallies = {rule.name: Tally(rule) for rule in self._trips}
        self._no_velocity = np.zeros(robot.num_joints)
        self._no_velocity.setflags(write=False)
        self._names = robot.joint_names
        names = [*(rule.name for rule in self._limits), *self._tallies, *OTHER_RULES]
        self.counts: dict[str, int] = dict.fromkeys(names, 0)

    def believed(self, reading: RobotState) -> RobotState:
        """What is believed of a reading: all but samples that no movement leads to. See Plausibility."""
        return self._gate.believed(reading)

    def check(self, sample: Sample, *, moving: bool, falling: bool = False) -> Fault | None:
        """First rule that trips on a state. moving: whether the joints are driven (not IDLE, not DAMPING). falling:
        whether they are only so that the body lands softly."""
        self._battery.look(sample.state)
        for rule in self._trips:
            asked = not rule.moving or (moving and not (falling and rule.upright))
            detail = rule.violation(sample) if asked else None
            self.counts[rule.name] += detail is not None
            if self._tallies[rule.name].lasts(detail is not None):
                return Fault(rule.name, detail or "")
        return None

    @property
    def warning(self) -> str | None:
        """What ends this run before long if it goes on like this, or None."""
        return next((forecast.warning for forecast in self._forecasts if forecast.warning is not None), None)

    @property
    def urgent(self) -> str | None:
        """Likewise so soon that a robot that stands is to be lowered, or None."""
        return next((forecast.warning for forecast in self._forecasts if forecast.urgent), None)

    def check_reading(self, error: DeviceError) -> Fault:
        """A read that failed: the device refuses, or the way to it is gone."""
        rule = "device_fault" if isinstance(error, DeviceFault) else "link_loss"
        return self.counted(Fault(rule, str(error)))

    def check_action(self, wish: Wish, output: PolicyOutput | None = None) -> Fault | None:
        """A wish that is not a number, or an actor's action that was none before it was clipped and blended."""
        for what, values in (("action", None if output is None else output.action), ("target", wish.target_rad)):
            if values is not None and not np.isfinite(values).all():
                bad = [name for name, value in zip(self._names, values) if not math.isfinite(value)]
                return self.counted(Fault("action_not_finite", f"{what} of {', '.join(bad[:3])} is not a number"))
        return None

    def counted(self, fault: Fault) -> Fault:
        """Count a fault that was found outside the rules on a state."""
        self.counts[fault.rule] += 1
        return fault

    def command(self, wish: Wish, state: RobotState) -> JointCommand:
        """The wish, limited. The only place where a command for a backend is made."""
        for rule in self._limits:
            limited = rule.limited(wish, state)
            if limited is not wish:
                self.counts[rule.name] += 1
                wish = wish if rule.report_only else limited
        self._late_hold.sent(wish.target_rad)
        return JointCommand(wish.target_rad, self._no_velocity, wish.kp, wish.kd, self._no_velocity)

    def reset(self) -> None:
        """The joints are not driven: forget what was sent, and violations of rules that ask only while they are."""
        for rule in self._trips:
            if rule.moving:
                self._tallies[rule.name].reset()
        self._late_hold.reset()
        self._gate.reset()
