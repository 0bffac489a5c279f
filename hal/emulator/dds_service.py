"""The onboard motion service of an emulated G1."""

import json
import threading
from collections.abc import Callable

from core import robot_time as time
from hal.dds.link import DdsLink
from hal.dds.motion_service import (
    BAD_PARAMETER,
    CHECK_MODE,
    DEPTH,
    OK,
    RELEASE_MODE,
    REQUEST_TOPIC,
    RESPONSE_TOPIC,
    SELECT_MODE,
    SERVER_VERSION,
    UNKNOWN_API,
    UNKNOWN_MODE,
)
from hal.dds.types import NO_BYTES, Request_, Response_, ResponseHeader_, ResponseStatus_

MODES = ("normal", "advanced", "ai", "ai-w")
VERSION = "1.0.0.1"


class MotionServer:
    """Answers the motion service's requests from a thread of its own. Letting go of the motors takes release_s.

    selected_at_rest: for each mode that was asked for, whether the robot was at rest then, as at_rest said.
    """

    def __init__(self, link: DdsLink, mode: str, release_s: float, at_rest: Callable[[], bool]) -> None:
        self.release_s, self._at_rest = release_s, at_rest
        self.selected_at_rest: list[bool] = []
        self._mode, self._released_s = mode, float("inf")
        self._lock = threading.Lock()
        self._responses = link.writer(RESPONSE_TOPIC, Response_)
        self._inbox = link.inbox(link.queue_reader(REQUEST_TOPIC, Request_, DEPTH), self._hear, "motion service")

    @property
    def failure(self) -> Exception | None:
        """What ended its thread, if anything did."""
        return self._inbox.failure

    @property
    def mode(self) -> str:
        """The mode that drives the motors now; empty once released."""
        with self._lock:
            return "" if time.monotonic() >= self._released_s else self._mode

    def select(self, mode: str) -> None:
        """Drive the motors in a mode; with an empty one, none."""
        with self._lock:
            self._mode, self._released_s = mode, float("inf")

    def stop(self) -> None:
        """Answer no more. May be repeated."""
        self._inbox.stop()

    def _hear(self, request: Request_, now_s: float) -> None:
        code, data = self._answer(request.header.identity.api_id, request.parameter, now_s)
        header = ResponseHeader_(request.header.identity, ResponseStatus_(code))
        self._responses.write(Response_(header, data, NO_BYTES))

    def _answer(self, api: int, parameter: str, now_s: float) -> tuple[int, str]:
        if api == SERVER_VERSION:
            return OK, VERSION
        if api == CHECK_MODE:
            return OK, json.dumps({"form": "0", "name": self.mode})
        if api == RELEASE_MODE:
            with self._lock:
                self._released_s = min(self._released_s, now_s + self.release_s)
            return OK, ""
        if api == SELECT_MODE:
            return self._selected(parameter)
        return UNKNOWN_API, ""

    def _selected(self, parameter: str) -> tuple[int, str]:
        try:
            name = json.loads(parameter)["name"]
        except (ValueError, TypeError, KeyError):
            return BAD_PARAMETER, ""
        if name not in MODES:
            return UNKNOWN_MODE, ""
        self.selected_at_rest.append(self._at_rest())
        self.select(name)
        return OK, ""
