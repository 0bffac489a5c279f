"""How a running robot is, for people and programs that look on."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.channels import plain
from deploy.safety.health import WindingTemperature
from hal.contract.types import RobotState
from robot.robot import Robot

BATTERY = "battery "


class Status:
    """An observer that keeps the latest tick; what is asked of it is worked out by who asks, in any thread.

    statistics: the wire's counters. Those whose names begin with "battery " are the battery's. winding: see Guard.
    """

    def __init__(
        self,
        robot: Robot,
        statistics: Callable[[], Mapping[str, Any]] | None = None,
        winding: WindingTemperature | None = None,
    ) -> None:
        self._robot, self._statistics, self._winding = robot, statistics, winding
        self._latest: tuple[float, RobotState | None, TickResult, PhaseTimer] | None = None

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        self._latest = (time.monotonic(), state, result, timer)

    def content(self) -> dict[str, Any]:
        """Plain data without a number that JSON does not have; null where something is not known."""
        wire = dict(self._statistics() if self._statistics is not None else {})
        battery = {n.removeprefix(BATTERY): v for n, v in wire.get("stats", {}).items() if n.startswith(BATTERY)}
        content: dict[str, Any] = {"mode": None, "battery": battery or None, "wire": wire or None}
        if self._latest is None:
            return content
        seen_s, state, result, timer = self._latest
        content |= {
            "mode": result.mode.value,
            "trip": None if result.fault is None else str(result.fault),
            "since_tick_s": time.monotonic() - seen_s,
            "ticks": timer.ticks,
            "overruns": timer.overruns,
        }
        return plain(content | ({} if state is None else self._of_state(state)))

    def _of_state(self, state: RobotState) -> dict[str, Any]:
        names, share = self._robot.joint_names, np.abs(state.joint_torque_nm) / self._robot.torque_limit_nm
        heat, winding = state.temperature_c, self._winding
        return {
            "device_faults": state.faults,
            "age_ms": {"joints": 1e3 * float(state.joint_age_s.max()), "imu": 1e3 * state.imu_age_s},
            "torque_share": dict(zip(names, share.tolist())),
            "temperature_c": None if heat is None else dict(zip(names, heat.tolist())),
            "winding_c": None if winding is None else dict(zip(names, winding.winding_c.tolist())),
            "minutes_left": None if winding is None else dict(zip(names, (winding.left_s / 60.0).tolist())),
        }


def line(content: Mapping[str, Any]) -> str:
    """The content in one line."""
    parts = [content["mode"] or "no tick yet"]
    if content.get("trip"):
        parts.append(f"fault {content['trip']}")
    if hottest := _largest(content.get("temperature_c")):
        parts.append(f"hottest {hottest[0]} {hottest[1]:.0f} C")
    left = {name: -minutes for name, minutes in (content.get("minutes_left") or {}).items() if minutes is not None}
    if soonest := _largest(left):
        parts.append(f"{soonest[0]} too hot in {-soonest[1]:.0f} minutes")
    if strained := _largest(content.get("torque_share")):
        parts.append(f"torque {strained[0]} {100.0 * strained[1]:.0f} %")
    if ages := content.get("age_ms"):
        parts.append(f"age joints {ages['joints']:.1f} ms, imu {ages['imu']:.1f} ms")
    if "ticks" in content:
        parts.append(f"overruns {content['overruns']} of {content['ticks']}")
    if content.get("battery"):
        parts.append("battery " + ", ".join(f"{name} {value:g}" for name, value in content["battery"].items()))
    return "   ".join(parts)


def text(content: Mapping[str, Any]) -> str:
    """The line, then a row for every joint."""
    rows = [line(content), *(f"device fault {fault}" for fault in content.get("device_faults", ()))]
    heat = content.get("temperature_c") or {}
    for joint, share in (content.get("torque_share") or {}).items():
        warm = "" if heat.get(joint) is None else f"{heat[joint]:6.0f} C"
        rows.append(f"  {joint:28} {'' if share is None else f'{100.0 * share:5.0f} %'} {warm}".rstrip())
    return "\n".join(rows) + "\n"


class StatusLine:
    """An observer that says the line every so many ticks."""

    def __init__(self, status: Status, every_ticks: int, say: Callable[[str], None]) -> None:
        self._status, self._every, self._say = status, every_ticks, say
        self._ticks = 0

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        self._ticks += 1
        if self._ticks % self._every == 0:
            self._say(line(self._status.content()))


def _largest(values: Mapping[str, float | None] | None) -> tuple[str, float] | None:
    known = [(value, name) for name, value in (values or {}).items() if value is not None]
    return (max(known)[1], max(known)[0]) if known else None
