"""Faults that the operator has seen, and one that comes at this moment."""

import threading
from types import SimpleNamespace

from hal.can.bus import CanBus


def test_faults_are_forgotten_between_rounds_never_within_one() -> None:
    """A round holds the bus; what it latches meanwhile is shown, and forgotten as a whole or not at all."""
    shown: dict[str, bool] = {}
    bus = SimpleNamespace(lock=threading.Lock(), _show=shown.__setitem__)
    motor = SimpleNamespace(joint="knee", latched=set(), damped_only=False)
    CanBus.latch(bus, motor, "too warm")  # type: ignore[arg-type]
    with bus.lock:
        forgetting = threading.Thread(target=CanBus.forget, args=(bus, motor))
        forgetting.start()
        forgetting.join(0.2)
        assert motor.damped_only and motor.latched == {"motor_fault:knee: too warm"} and all(shown.values())
        CanBus.latch(bus, motor, "is off")  # type: ignore[arg-type]
    forgetting.join(5.0)
    assert not motor.damped_only and motor.latched == set()
    assert shown == {"motor_fault:knee: too warm": False, "motor_fault:knee: is off": False}
