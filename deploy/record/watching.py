"""What keeps a run and shows it: its log, or the last seconds of it; its status."""

import contextlib
import sys

from deploy.control.loop import Observer
from deploy.operator.voice import Voice
from deploy.options import RunOptions
from deploy.record.last_seconds import INCIDENTS, LastSeconds
from deploy.record.log import McapLog
from deploy.record.messages import TickMessages
from deploy.record.status import Status, StatusLine
from deploy.record.status_server import StatusServer
from deploy.safety.health import WindingTemperature
from deploy.settings import RecordSettings
from hal.contract.backend import Backend
from hal.wire.backend import WireBackend
from robot.robot import Robot


def watching(
    options: RunOptions,
    robot: Robot,
    backend: Backend,
    winding: WindingTemperature | None,
    settings: RecordSettings,
    voice: Voice,
    stack: contextlib.ExitStack,
) -> list[Observer]:
    """What looks on every tick, open until `stack` ends. Raises InputError where a log or a port cannot be had."""
    wire = backend if isinstance(backend, WireBackend) else None
    messages = TickMessages() if wire is None else TickMessages(wire.remote, wire.statistics)
    about = {"backend": options.backend, "policy": options.policies[0], "robot": robot.name}
    status = Status(robot, None if wire is None else wire.statistics, winding)
    observers: list[Observer] = [status]
    if options.log is not None:
        log = McapLog(options.log, robot, about, messages, may_wait=not options.on_wall_clock, complain=voice.complain)
        voice.say(f"log {log.path}")
        observers.append(stack.enter_context(log))
    elif options.on_wall_clock:
        kept = LastSeconds(
            INCIDENTS, robot, about, messages,
            settings=settings, period_s=backend.control_period_s, say=voice.complain,
        )  # fmt: skip
        observers.append(stack.enter_context(kept))
    if options.status_port is not None:
        server = stack.enter_context(StatusServer(status, options.status_port))
        voice.say(f"status {server.address}")
    every = round(settings.status_line_s / backend.control_period_s)
    if every and options.attended and sys.stdout.isatty():
        observers.append(StatusLine(status, every, voice.say))
    return observers
