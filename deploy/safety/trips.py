"""Every rule that ends a movement."""

from deploy.safety import body, health
from deploy.safety.rules import TripRule
from deploy.safety.settings import SafetySettings
from robot.robot import Robot

CLOCK_GRAIN_S = 1e-6


def ticks_of(lasting_s: float, period_s: float) -> int:
    """Control ticks in a row that a violation of this length takes; at least one."""
    return max(1, round(lasting_s / period_s))


def trip_rules(robot: Robot, safety: SafetySettings, period_s: float, gate: TripRule) -> tuple[TripRule, ...]:
    """All rules that look at a state, in the order in which they are asked. gate: that on what is believed of it.

    A fall comes before what it does to the joints: it is answered otherwise.
    """

    def ticks(lasting_s: float) -> int:
        return ticks_of(lasting_s, period_s)

    s = safety
    inference_s = s.inference_overrun.periods * period_s
    winding: list[TripRule] = []
    if robot.thermal is not None:
        w = s.winding_temperature
        max_c = robot.thermal.limit_c - w.below_limit_c
        winding = [health.WindingTemperature(robot, robot.thermal, max_c, w.warn_s, w.lower_s, ticks(w.for_s))]
    window = ticks(s.overrun.window_s)
    often = max(1, round(s.overrun.share * window)), window
    return (
        health.StateNotFinite(robot),
        health.DeviceReport(),
        gate,
        health.Stale(robot, s.stale.trip_periods * period_s - CLOCK_GRAIN_S),
        health.Temperature(robot, s.temperature.max_c, ticks(s.temperature.for_s)),
        *winding,
        body.Tilt(s.tilt, ticks(s.tilt.for_s)),
        body.BaseRate(s.base_rate, ticks(s.base_rate.for_s)),
        body.PositionRange(robot, s.position_range.margin_rad, ticks(s.position_range.for_s)),
        body.JointSpeed(robot, s.joint_speed, ticks(s.joint_speed.for_s)),
        body.TorqueSaturation(
            robot, s.torque_saturation.factor, s.torque_saturation.joints, ticks(s.torque_saturation.for_s)
        ),
        health.InferenceOverrun(inference_s, ticks(s.inference_overrun.for_s)),
        health.Overrun(s.overrun.in_a_row, often),
    )
