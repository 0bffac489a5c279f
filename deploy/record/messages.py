"""What one tick says to a log."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.record.channels import CHANNELS, Message
from deploy.safety.rules import Fault
from hal.contract.types import RobotState

SECOND_NS = 1_000_000_000


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
        self._finishing = False
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
        if result.finishing and not self._finishing:
            events.append(("ending", "waits until the robot can be lowered"))
        self._finishing = result.finishing
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
