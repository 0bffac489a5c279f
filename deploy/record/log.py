"""One MCAP file per run, with JSON-schema channels that Foxglove and PlotJuggler read."""

import json
import math
import queue
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from mcap.writer import Writer

from core.errors import InputError
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.safety.rules import Fault
from hal.contract.types import RobotState
from robot.robot import Robot

QUEUE_MESSAGES = 2048
NUMBER: dict[str, Any] = {"type": ["number", "null"]}
NUMBERS: dict[str, Any] = {"type": "array", "items": NUMBER}
TEXT: dict[str, Any] = {"type": "string"}
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
        "true_root_pos_w": NUMBERS,
        "true_root_quat_wxyz": NUMBERS,
        "true_foot_contact": NUMBERS,
    },
    "/command": {"q_rad": NUMBERS, "kp": NUMBERS, "kd": NUMBERS},
    "/observation": {"groups": {"type": "object", "additionalProperties": NUMBERS}},
    "/action": {
        "policy_sha256": TEXT,
        "motion": TEXT,
        "tick": {"type": "integer"},
        "action": NUMBERS,
        "target_rad": NUMBERS,
    },
    "/events": {"event": TEXT, "detail": TEXT},
    "/timing": {"tick": {"type": "integer"}, "overruns": {"type": "integer"}, "phases_ms": {"type": "object"}},
}


class McapLog:
    """Writes beside the loop, in a thread of its own: a slow disk delays no tick.

    Arrays are in the robot's joint order, which is in the file's metadata. null stands for what is not a number.
    A context manager; whatever ended the run, the file is complete up to there. Also an Observer.
    may_wait: whether a full queue holds the loop up (a run on simulated time) or costs messages, counted in `dropped`.
    """

    def __init__(self, folder: Path, robot: Robot, about: dict[str, str], *, may_wait: bool) -> None:
        folder.mkdir(exist_ok=True)
        self.path = folder / time.strftime("run-%Y%m%d-%H%M%S.mcap")
        attempt = 1
        while self.path.exists():
            attempt += 1
            self.path = folder / time.strftime(f"run-%Y%m%d-%H%M%S-{attempt}.mcap")
        self._file = self.path.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile="", library="kata")
        self._channels = {topic: self._register(topic, fields) for topic, fields in CHANNELS.items()}
        self._writer.add_metadata("run", {**about, "joint_names": json.dumps(robot.joint_names)})
        self._queue: queue.Queue[tuple[str, int, dict[str, Any]] | None] = queue.Queue(QUEUE_MESSAGES)
        self._may_wait = may_wait
        self.dropped = 0
        self._thread = threading.Thread(target=self._drain, name="log", daemon=True)
        self._error: OSError | None = None
        self._fault: Fault | None = None
        self._last_ns = 0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._queue.put(None)
        self._thread.join()
        with self._file:
            self._writer.finish()
        if self.dropped:
            print(f"log: {self.dropped} messages lost to a slow disk", file=sys.stderr)
        if self._error is not None:
            raise InputError(f"the log could not be written ({self._error.strerror})", where=self.path) from self._error

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer. Times are those of the loop's clock; an unread state has the time of the one before."""
        now_ns = self._last_ns if state is None else round(1e9 * state.time_s)
        self._last_ns = now_ns
        if state is not None:
            self._put("/state", now_ns, _state_fields(state))
        self._put_events(now_ns, result)
        if result.output is not None and result.actor is not None:
            spec_tick, output = result.actor.tick - 1, result.output
            self._put("/observation", now_ns, {"groups": output.observation})
            fields = {"tick": spec_tick, "action": output.action, "target_rad": output.target_rad}
            self._put(
                "/action", now_ns, {"policy_sha256": result.actor.actor.sha256, "motion": result.actor.name, **fields}
            )
        if (command := result.command) is not None:
            self._put("/command", now_ns, {"q_rad": command.q_rad, "kp": command.kp, "kd": command.kd})
        phases = {phase: 1e3 * spent_s for phase, spent_s in timer.laps_s.items()}
        self._put("/timing", now_ns, {"tick": timer.ticks, "overruns": timer.overruns, "phases_ms": phases})

    def _put_events(self, now_ns: int, result: TickResult) -> None:
        for mode in result.modes:
            self._put("/events", now_ns, {"event": "state", "detail": mode.value})
        for refusal in result.refused:
            self._put("/events", now_ns, {"event": "refused", "detail": refusal})
        if result.fault is not self._fault:
            self._fault = result.fault
            self._put("/events", now_ns, {"event": "fault", "detail": str(result.fault or "cleared")})

    def _put(self, topic: str, time_ns: int, fields: dict[str, Any]) -> None:
        try:
            self._queue.put((topic, time_ns, fields), block=self._may_wait)
        except queue.Full:
            self.dropped += 1

    def _register(self, topic: str, fields: dict[str, Any]) -> int:
        schema = {"type": "object", "properties": fields}
        data = json.dumps(schema).encode()
        schema_id = self._writer.register_schema(
            name=f"kata{topic.replace('/', '.')}", encoding="jsonschema", data=data
        )
        return self._writer.register_channel(topic=topic, message_encoding="json", schema_id=schema_id)

    def _drain(self) -> None:
        while (entry := self._queue.get()) is not None:
            if self._error is not None:
                continue
            topic, time_ns, fields = entry
            data = json.dumps(_plain(fields), allow_nan=False).encode()
            try:
                self._writer.add_message(self._channels[topic], log_time=time_ns, publish_time=time_ns, data=data)
            except OSError as error:
                self._error = error


def _state_fields(state: RobotState) -> dict[str, Any]:
    fields = {name: getattr(state, name) for name in CHANNELS["/state"] if hasattr(state, name)}
    if state.temperature_c is None:
        del fields["temperature_c"]
    if (truth := state.truth) is not None:
        fields["true_root_pos_w"] = truth.root_pos_w
        fields["true_root_quat_wxyz"] = truth.root_quat_wxyz
        fields["true_foot_contact"] = truth.foot_contact.astype(np.float64)
    return fields


def _plain(value: Any) -> Any:
    """What JSON can hold; float32 becomes the double of the same value."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, np.ndarray):
        numbers: Sequence[Any] = value.tolist()
        return numbers if np.isfinite(value).all() else [_plain(number) for number in numbers]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
