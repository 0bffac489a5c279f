"""Time on the wire against the published figures for CAN 2.0 and CAN-FD."""

import pytest

from core.errors import InputError
from hal.can.bus_load import bus_loads, check_loads, frame_time_s, load_table
from hal.can.frame import Frame
from hal.can.robot_file import load_robot_file
from tests.hal.can.rig import ANKLE, ELBOW, HIP, KNEE, motor, robot_file

M, M5 = 1_000_000, 5_000_000


@pytest.mark.parametrize(
    ("extended", "length", "least_us", "most_us"), [(False, 8, 111, 135), (True, 8, 131, 160), (False, 0, 47, 55)]
)
def test_classic_frames(extended: bool, length: int, least_us: float, most_us: float) -> None:
    frame = Frame(1, bytes(length), extended)
    assert 1e6 * frame_time_s(frame, M, M5, stuffed=False) == pytest.approx(least_us)
    assert 1e6 * frame_time_s(frame, M, M5) == pytest.approx(most_us)
    assert frame_time_s(frame, M // 2, M5) == pytest.approx(2.0 * frame_time_s(frame, M, M5))


@pytest.mark.parametrize(
    ("length", "least_us", "most_us"),
    [(8, 49, 57), (16, 62, 73), (24, 76, 90), (32, 89, 106), (48, 114, 138), (64, 140, 170)],
)
def test_fd_frames(length: int, least_us: float, most_us: float) -> None:
    frame = Frame(1, bytes(length), fd=True)
    assert 1e6 * frame_time_s(frame, M, M5, stuffed=False) == pytest.approx(least_us, abs=1.5)
    assert 1e6 * frame_time_s(frame, M, M5) == pytest.approx(most_us, abs=1.5)
    longer = frame_time_s(Frame(1, bytes(length), True, True), M, M5, stuffed=False)
    assert 1e6 * longer - 1e6 * frame_time_s(frame, M, M5, stuffed=False) == pytest.approx(19.0)


@pytest.mark.parametrize(("motors", "ceiling_hz"), [(6, 617), (7, 529), (10, 370), (12, 309), (20, 185)])
def test_ceilings_of_a_damiao_bus(motors: int, ceiling_hz: float) -> None:
    names = load_robot_file().motors
    file = robot_file(*(motor(names[i].joint, 1 + i if i < 15 else 0x30 + i) for i in range(motors)))
    assert bus_loads(file)[0].ceiling_hz == pytest.approx(ceiling_hz, abs=1.0)


def test_ceiling_of_a_robstride_bus() -> None:
    file = robot_file(
        *(motor(name, i + 1, codec="robstride", model="RS04") for i, name in enumerate((HIP, KNEE, ELBOW, ANKLE)))
    )
    assert bus_loads(file)[0].ceiling_hz == pytest.approx(1e6 / (4 * 320), abs=1.0)


def test_what_motors_send_by_themselves_counts() -> None:
    """ODrive: three frames to it a round (135 + 119 + 135 us at most), and four of 135 us from it every 10 ms."""
    load = bus_loads(robot_file(motor(HIP, 1, codec="odrive", model="S1")))[0]
    assert load.ceiling_hz == pytest.approx((1.0 - 4 * 135e-6 / 0.01) / load.round_s)


def test_more_than_80_percent_is_refused() -> None:
    check_loads(bus_loads(robot_file(*(motor(name, i + 1) for i, name in enumerate((HIP, KNEE))), rate_hz=1480.0)))
    loads = bus_loads(robot_file(*(motor(name, i + 1) for i, name in enumerate((HIP, KNEE))), rate_hz=1490.0))
    with pytest.raises(
        InputError, match=r"bus bus: too much traffic, got 80% at 1490 Hz, expected at most 80%: rate_hz up to 1481"
    ):
        check_loads(loads)


def test_the_shipped_robot_and_its_table() -> None:
    loads = bus_loads(load_robot_file("can_g1"))
    check_loads(loads)
    assert [load.motors for load in loads] == [6, 6, 7, 4]
    table = load_table(loads).splitlines()
    assert len(table) == 5
    assert "617 Hz" in table[1]
