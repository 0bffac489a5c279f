"""What a robot may be doing, what may be asked of it, and what may be asked when."""

import enum


class Mode(enum.Enum):
    """What the robot is doing. The value is the line that a change prints."""

    IDLE = "IDLE"
    DAMPING = "damping"
    STAND_UP = "STAND_UP"
    FIXED_STAND = "FIXED_STAND"
    READY = "READY"
    TRACKING = "TRACKING"
    HOLD = "HOLD"
    LOWERING = "LOWERING"
    BRACING = "BRACING"


class Request(enum.Enum):
    """What may be asked for. FINISH ends the run in order, QUIT at once. LOWER puts the robot down now; where nobody
    balances it, it is damped."""

    STAND = "stand"
    START = "start"
    HOLD = "hold"
    SWITCH = "switch"
    DAMP = "damp"
    ACKNOWLEDGE = "acknowledge"
    LOWER = "lower"
    FINISH = "finish"
    QUIT = "quit"


ALLOWED: dict[Request, frozenset[Mode]] = {
    Request.STAND: frozenset({Mode.IDLE, Mode.FIXED_STAND}),
    Request.START: frozenset({Mode.READY, Mode.HOLD}),
    Request.HOLD: frozenset({Mode.TRACKING}),
    Request.SWITCH: frozenset(Mode) - {Mode.DAMPING},
    Request.DAMP: frozenset(Mode),
    Request.ACKNOWLEDGE: frozenset({Mode.IDLE, Mode.DAMPING}),
    Request.LOWER: frozenset(Mode),
    Request.FINISH: frozenset(Mode),
    Request.QUIT: frozenset(Mode),
}
RESTING = frozenset({Mode.IDLE, Mode.DAMPING})
RISING = frozenset({Mode.STAND_UP, Mode.FIXED_STAND})
BALANCED = frozenset({Mode.READY, Mode.TRACKING, Mode.HOLD})
STANDING = frozenset({Mode.READY, Mode.HOLD})
