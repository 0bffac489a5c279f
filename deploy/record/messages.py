"""What one tick says to a log: channels, their fields, and the numbers in them."""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.safety.rules import Fault
from hal.contract.types import RobotState

SECOND_NS = 1_000_000_000
NUMBER: dict[str, Any] = {"type": ["number", "null"]}
NUMBERS: dict[str, Any] = {"type": "array", "items": NUMBER}
INTEGER: dict[str, Any] = {"type": "integer"}
TEXT: dict[str, Any] = {"type": "string"}
TEXTS: dict[str, Any] = {"type": "array", "items": TEXT}
OBJECT: dict[str, Any] = {"type": "object"}
CHANNELS: dict[str, dict[str, Any]] = {
    "/state": {
        "joint_pos_rad": NUMBERS,
        "joint_vel_rad_s": NUMBERS,
        "joint_torque_nm": NUMBERS,
        "joint_age_s": NUMBERS,
        "imu_quat_wxyz": NUMBERS,
        "imu_ang_vel_b": NUMBERS,
        "imu_acc_b": NUMBERS,
        "imu_age_s": NUMBER,
        "temperature_c": NUMBERS,
        "charge": NUMBER,
        "supply": NUMBER,
        "supply_high": NUMBER,
        "true_root_pos_w": NUMBERS,
        "true_root_quat_wxyz": NUMBERS,
        "true_foot_contact": NUMBERS,
    },
    "/command": {"q_rad": NUMBERS, "kp": NUMBERS, "kd": NUMBERS},
    "/observation": {"groups": {"type": "object", "additionalProperties": NUMBERS}},
    "/action": {"policy_sha256": TEXT, "motion": TEXT, "tick": INTEGER, "action": NUMBERS, "target_rad": NUMBERS},
    "/condition": {"mode": TEXT, "trip": TEXT, "device_faults": TEXTS},
    "/remote": {"buttons": TEXTS, "age_s": NUMBER},
    "/events": {"event": TEXT, "detail": TEXT},
    "/timing": {"tick": INTEGER, "overruns": INTEGER, "phases_ms": OBJECT},
    "/wire": {"cycles": OBJECT, "stats": OBJECT},
    "/clock": {"unix_s": NUMBER},
}
Message = tuple[str, int, dict[str, Any]]
"""Channel, time of the loop's clock in ns, fields."""


class TickMessages:
    """Turns ticks into messages. It remembers only what has changed since the tick before.

    remote: buttons pressed on the robot's remote and how long ago they were heard in s. statistics: the wire's.
    """

    def __init__(
        self,
        remote: Callable[[], tuple[Sequence[str], float]] | None = None,
        statistics: Callable[[], Mapping[str, Any] | None] | None = None,
    ) -> None:
        self._remote, self._statistics = remote, statistics
        self._fault: Fault | None = None
        self._last_ns = 0
        self._second = -1

    def of(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> list[Message]:
        """One tick's, all of one time: the state's; an unread state has the time of the one before."""
        self._last_ns = now_ns = self._last_ns if state is None else round(1e9 * state.time_s)
        said: list[tuple[str, dict[str, Any]]] = [] if state is None else [("/state", _state_fields(state))]
        said.append(("/condition", _condition(state, result)))
        said += [("/events", {"event": event, "detail": detail}) for event, detail in self._events(result)]
        if (output := result.output) is not None and (actor := result.actor) is not None:
            about = {"policy_sha256": actor.actor.sha256, "motion": actor.name, "tick": actor.tick - 1}
            said.append(("/observation", {"groups": output.observation}))
            said.append(("/action", {**about, "action": output.action, "target_rad": output.target_rad}))
        if (command := result.command) is not None:
            said.append(("/command", {"q_rad": command.q_rad, "kp": command.kp, "kd": command.kd}))
        phases = {phase: 1e3 * spent_s for phase, spent_s in timer.laps_s.items()}
        said.append(("/timing", {"tick": timer.ticks, "overruns": timer.overruns, "phases_ms": phases}))
        return [(topic, now_ns, fields) for topic, fields in [*said, *self._around(now_ns)]]

    def _events(self, result: TickResult) -> list[tuple[str, str]]:
        events = [("request", request.value) for request in result.requests]
        events += [("state", mode.value) for mode in result.modes]
        events += [("refused", refusal) for refusal in result.refused]
        events += [] if result.lowered_by is None else [("lowered", result.lowered_by)]
        if result.fault is not self._fault:
            self._fault = result.fault
            events.append(("fault", str(result.fault or "cleared")))
        return events

    def _around(self, now_ns: int) -> list[tuple[str, dict[str, Any]]]:
        """The remote at every tick where one is heard; the wire's statistics and the wall clock once a second."""
        said: list[tuple[str, dict[str, Any]]] = []
        if self._remote is not None:
            buttons, age_s = self._remote()
            if math.isfinite(age_s):
                said.append(("/remote", {"buttons": list(buttons), "age_s": age_s}))
        if now_ns // SECOND_NS != self._second:
            self._second = now_ns // SECOND_NS
            said.append(("/clock", {"unix_s": time.time()}))
            if self._statistics is not None and (statistics := self._statistics()):
                said.append(("/wire", dict(statistics)))
        return said


def encoded(fields: Mapping[str, Any]) -> bytes:
    """JSON in which null stands for what is not a number."""
    return json.dumps(plain(fields), allow_nan=False).encode()


def plain(value: Any) -> Any:
    """What JSON can hold; float32 becomes the double of the same value."""
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        numbers: Sequence[Any] = value.tolist()
        return numbers if np.isfinite(value).all() else [plain(number) for number in numbers]
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value


def _condition(state: RobotState | None, result: TickResult) -> dict[str, Any]:
    faults = () if state is None else state.faults
    return {"mode": result.mode.value, "trip": str(result.fault or ""), "device_faults": list(faults)}


def _state_fields(state: RobotState) -> dict[str, Any]:
    fields = {name: getattr(state, name) for name in CHANNELS["/state"] if hasattr(state, name)}
    if state.temperature_c is None:
        del fields["temperature_c"]
    if (truth := state.truth) is not None:
        fields["true_root_pos_w"] = truth.root_pos_w
        fields["true_root_quat_wxyz"] = truth.root_quat_wxyz
        fields["true_foot_contact"] = truth.foot_contact.astype(np.float64)
    return fields
