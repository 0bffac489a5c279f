"""Which servo is looked at next."""

import time
from types import SimpleNamespace

from hal.dynamixel.group import ServoGroup
from hal.dynamixel.port import Silent


def test_an_alert_waits_for_a_round_that_has_time_for_it() -> None:
    """Row 2 has raised an alert: a round that is late asks nobody, the next one asks servo 30."""
    asked = []

    def ask(servo_id: int, *_: object) -> None:
        asked.append(servo_id)
        raise Silent("nobody")

    now_s = time.monotonic()
    group = SimpleNamespace(
        _alerts={2}, _rounds=1, _asked_s=now_s, _stamp_s=[now_s] * 3, port=SimpleNamespace(ask=ask),
        servos=[SimpleNamespace(id=one) for one in (10, 20, 30)],
    )  # fmt: skip
    ServoGroup._inspect(group, now_s - 1.0)  # type: ignore[arg-type]
    assert asked == [] and group._alerts == {2}
    ServoGroup._inspect(group, now_s + 60.0)  # type: ignore[arg-type]
    assert asked == [30] and group._alerts == set()
