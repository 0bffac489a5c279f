"""Taking the motors over from the robot's onboard motion service, by its request topics."""

import itertools
import json
import math
from collections.abc import Mapping
from time import monotonic_ns
from typing import Any

from core import robot_time as time
from hal.contract.types import DeviceError, DeviceFault
from hal.dds.link import DdsLink
from hal.dds.types import NO_BYTES, Request_, RequestHeader_, RequestIdentity_, RequestLease_, RequestPolicy_, Response_

REQUEST_TOPIC = "rt/api/motion_switcher/request"
RESPONSE_TOPIC = "rt/api/motion_switcher/response"
SERVER_VERSION, CHECK_MODE, SELECT_MODE, RELEASE_MODE = 1, 1001, 1002, 1003
OK, BAD_PARAMETER, BUSY, UNKNOWN_MODE, UNKNOWN_API = 0, 7001, 7002, 7004, 3203
ERRORS = {
    BAD_PARAMETER: "wrong parameter",
    BUSY: "busy",
    UNKNOWN_MODE: "unknown mode",
    7005: "command failed",
    7006: "command failed",
    7007: "command failed",
    7008: "command failed",
    7009: "configuration",
    UNKNOWN_API: "unknown request",
}
MATCH_S = 2.0
ANSWER_S = 2.0
ASK_AGAIN_S = 0.5
CHECK_S = 0.05
POLL_S = 0.005
DEPTH = 8


class MotionService:
    """The client. Every method raises DeviceError where the service is absent, DeviceFault where it refuses.

    For one thread at a time.
    """

    def __init__(self, link: DdsLink) -> None:
        self._requests = link.writer(REQUEST_TOPIC, Request_)
        self._responses = link.queue_reader(RESPONSE_TOPIC, Response_, DEPTH)
        self._ids = itertools.count(monotonic_ns())

    def active_mode(self) -> str:
        """The mode in which the service drives the motors; empty where it has released them."""
        answer = self._ask(CHECK_MODE)
        name = answer.get("name")
        if not isinstance(name, str):
            raise DeviceFault(f"dds: the motion service answered {answer}, expected the name of a mode")
        return name

    def release(self, limit_s: float) -> list[str]:
        """Have it let go of the motors: the robot goes limp. The modes that were active, in the order of release.

        Raises DeviceFault where one is still active after limit_s.
        """
        released: list[str] = []
        asked_s, end_s = -math.inf, time.monotonic() + limit_s
        while name := self.active_mode():
            now_s = time.monotonic()
            if now_s > end_s:
                raise DeviceFault(f"dds: the motion service keeps mode {name!r} after {limit_s:g} s of asking")
            if name not in released:
                released.append(name)
            if now_s - asked_s > ASK_AGAIN_S:
                self._ask(RELEASE_MODE, patient=True)
                asked_s = now_s
            time.sleep(CHECK_S)
        return released

    def select(self, mode: str, limit_s: float) -> None:
        """Have it drive the motors in a mode. Raises DeviceFault where it does not within limit_s."""
        end_s = time.monotonic() + limit_s
        self._ask(SELECT_MODE, {"name": mode})
        while (active := self.active_mode()) != mode:
            if time.monotonic() > end_s:
                raise DeviceFault(f"dds: the motion service is in mode {active!r} {limit_s:g} s after {mode!r}")
            time.sleep(CHECK_S)

    def _ask(self, api: int, parameter: Mapping[str, str] | None = None, *, patient: bool = False) -> dict[str, Any]:
        """One request and its answer's content. patient: a busy service is no error."""
        self._await_service()
        identity = RequestIdentity_(next(self._ids), api)
        header = RequestHeader_(identity, RequestLease_(0), RequestPolicy_(0, False))
        self._responses.take(N=DEPTH)
        self._requests.write(Request_(header, json.dumps(parameter or {}), NO_BYTES))
        response = self._await_response(identity.id)
        code = response.header.status.code
        if code == BUSY and patient:
            return {}
        if code != OK:
            raise DeviceFault(f"dds: the motion service refused request {api}: {code} {ERRORS.get(code, '')}".rstrip())
        try:
            content = json.loads(response.data or "{}")
        except ValueError as error:
            raise DeviceFault(f"dds: the motion service answered no JSON: {response.data[:80]!r}") from error
        return content if isinstance(content, dict) else {}

    def _await_service(self) -> None:
        """What is written before the service has been found is lost."""
        end_s = time.monotonic() + MATCH_S
        while not (self._requests.get_matched_subscriptions() and self._responses.get_matched_publications()):
            if time.monotonic() > end_s:
                raise DeviceError(
                    f"dds: no motion service answers on {REQUEST_TOPIC}; where the robot has none, set "
                    "`motion_service: none`"
                )
            time.sleep(POLL_S)

    def _await_response(self, request: int) -> Response_:
        end_s = time.monotonic() + ANSWER_S
        while time.monotonic() < end_s:
            for response in self._responses.take(N=DEPTH):
                if isinstance(response, Response_) and response.header.identity.id == request:
                    return response
            time.sleep(POLL_S)
        raise DeviceError(f"dds: the motion service has not answered within {ANSWER_S:g} s")
