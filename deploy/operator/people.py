"""Who may ask a run for something: the people at keyboard, gamepad and remote."""

import contextlib
from collections.abc import Callable, Sequence

from core.clock import Clock
from deploy.control.modes import Mode
from deploy.operator.buttons import Buttons
from deploy.operator.far_end import FarEnd
from deploy.operator.gamepad import Gamepad
from deploy.operator.keyboard import Keyboard
from deploy.operator.keys import RequestSource, StopSource
from deploy.operator.presence import Presence
from deploy.operator.remote import RemoteButtons
from deploy.operator.sticks import Sticks
from deploy.operator.takeover import Consent, Takeover
from deploy.operator.voice import Voice
from deploy.options import RunOptions
from deploy.settings import OperatorSettings
from hal.contract.backend import Backend
from hal.wire.backend import WireBackend


def people(
    options: RunOptions,
    backend: Backend,
    mode: Callable[[], Mode],
    settings: OperatorSettings,
    clock: Clock,
    voice: Voice,
    stack: contextlib.ExitStack,
    buttons: Sequence[StopSource] = (),
    sticks: Sticks | None = None,
) -> list[RequestSource]:
    """What the loop asks every tick, open until `stack` ends. mode: the machine's present state.

    On a real wire somebody has to be there while the robot moves, and to agree before it is taken over. buttons: that
    stop, see Takeover. sticks: what they steer by, where they steer.
    """
    consent = Consent() if options.on_real_wire else None
    sources: list[StopSource] = []
    if options.attended:
        far_end = FarEnd(clock, settings.terminal_silent_s) if consent is not None else None
        keyboard = Keyboard(say=voice.say, consent=consent, sticks=sticks, far_end=far_end)
        sources.append(stack.enter_context(keyboard))
    if options.gamepad is not None:
        pad = Buttons(consent, settings.chord_s)
        gamepad = Gamepad(options.gamepad, pad, clock, settings.gamepad_silent_s, voice.say, sticks)
        sources.append(stack.enter_context(gamepad))
    if isinstance(backend, WireBackend):
        remote = Buttons(consent, settings.chord_s)
        silent_s, ways = settings.remote_silent_s, backend.remote_sticks
        sources.append(RemoteButtons(backend.remote, remote, clock, silent_s, sticks, ways))
    if consent is None:
        return [*buttons, *sources]
    present = Presence(sources, mode, clock, settings, voice.complain)
    return [Takeover(sources, consent, voice.complain, mode, buttons), present]
