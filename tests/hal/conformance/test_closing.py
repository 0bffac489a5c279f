"""However silent the devices are and whatever is under way, closing takes less than 5 s, and the far end is damped."""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from core.clock import MonotonicClock
from hal.open import WIRES, wire_factory
from hal.wire.backend import WireBackend
from tests.hal.conformance.rigs import Emulators, ready, wait_until
from tests.hal.rigs import G1, hold

pytestmark = pytest.mark.real_time

PERIOD_S = 0.05
BOUND_S = 5.0
# phase: what is under way when everything falls silent and the loop closes.
PHASES = ("enabling", "driven", "damped", "acknowledging")


class Wire:
    """A backend on an emulator that lives on when it is closed."""

    def __init__(self, name: str, running: Emulators) -> None:
        config = running.config(name)
        self.emulator = running.get(name, config)
        factory = wire_factory(name, config, self.emulator.endpoints)
        times = {"control_period_s": PERIOD_S, "link_timeout_s": 5 * PERIOD_S}
        self.backend = WireBackend(name, G1, MonotonicClock(), factory, **times)
        self.backend.open()
        ready(self.backend)

    def drive(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.backend.write(hold(G1))
            time.sleep(PERIOD_S)

    def close(self) -> float:
        """How long it took."""
        begun_s = time.monotonic()
        self.backend.close()
        return time.monotonic() - begun_s

    def modes(self) -> set[str]:
        return set(self.emulator.control.status()["mode"].values())


@pytest.fixture
def wire(request: pytest.FixtureRequest, running: Emulators) -> Iterator[Wire]:
    if request.param == "dds":
        pytest.importorskip("cyclonedds")
    made = Wire(request.param, running)
    yield made
    made.close()
    made.emulator.control.clear_fault()


@pytest.mark.parametrize("wire", WIRES, indirect=True)
@pytest.mark.parametrize("phase", PHASES)
def test_closing_on_silent_devices_is_bounded(wire: Wire, phase: str) -> None:
    control = wire.emulator.control
    if phase == "enabling":
        control.fault("silence", "*")
        wire.backend.damp()
        time.sleep(0.3)
    else:
        wire.drive(1.0)
        wait_until(lambda: wire.modes() == {"driven"})
        if phase == "damped":
            wire.backend.damp()
        control.fault("silence", "*")
        if phase == "acknowledging":
            time.sleep(0.7)
            wire.backend.acknowledge()
            time.sleep(0.3)
    assert wire.close() < BOUND_S
    assert "driven" not in wire.modes()


@pytest.mark.parametrize("wire", ["dds"], indirect=True)
@pytest.mark.parametrize(("release_s", "quit_s"), [(2.0, 1.0), (6.0, 0.5)])
def test_quit_while_the_motion_service_lets_go_ends_in_damping(wire: Wire, release_s: float, quit_s: float) -> None:
    """Nothing is sent beside the service; when it has let go the robot is damped, and disabled once it rests."""
    control = wire.emulator.control
    control.device(release_s=release_s)
    asked_s = time.monotonic()
    wire.backend.damp()
    time.sleep(quit_s)
    with ThreadPoolExecutor(1) as pool:
        closing = pool.submit(wire.close)
        wait_until(lambda: wire.modes() == {"damped"}, release_s + 3.0)
        damped_s = time.monotonic() - asked_s
        assert closing.result() < BOUND_S
    wait_until(lambda: wire.modes() == {"slack"}, 6.0)
    control.device(release_s=0.2)
    assert release_s < damped_s < release_s + 1.5
    assert control.status()["violations"]["counts"] == {}
