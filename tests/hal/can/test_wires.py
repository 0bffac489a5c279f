"""The same servos over each transport that needs no CAN hardware."""

import contextlib
import select
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

import hal.can.link
from hal.can.bus import CanBus
from hal.can.frame import Frame
from hal.can.link import CanLink
from hal.can.setup import prepare, switch_off, switch_on
from hal.can.talk import ask
from hal.contract.types import DeviceError
from hal.emulator.can_wire import parse_slcan, slcan_line
from hal.emulator.socketcand import SocketcandServer, frame_text, parse_send
from tests.hal.can.rig import ELBOW, G1, HIP, KNEE, index, motor, robot_file, served

DAMIAO_AND_ROBSTRIDE = (motor(HIP, 1), motor(KNEE, 2, codec="robstride", model="RS04", direction=-1, gear=1.3))
ECHOING = (motor(HIP, 3, codec="cubemars", model="AK10-9", options={"keeps_zero": True}), motor(ELBOW, 5))
MULTICAST_PROBE = """
import can
bus = can.Bus(interface="udp_multicast", channel="239.74.163.2", port=43113, hop_limit=0)
bus.shutdown()
"""


@pytest.mark.parametrize("transport", ["socketcand", "slcan", "virtual", "udp_multicast"])
def test_a_conversation_over(transport: str) -> None:
    if (
        transport == "udp_multicast"
        and subprocess.run([sys.executable, "-c", MULTICAST_PROBE], capture_output=True).returncode
    ):
        pytest.skip("no multicast route here")
    motors = ECHOING if transport == "udp_multicast" else DAMIAO_AND_ROBSTRIDE
    with served(robot_file(*motors), transport) as (file, line):
        talk(file, line)


def test_odrives_that_send_by_themselves() -> None:
    options = {"enable_watchdog_endpoint": 400, "watchdog_timeout_endpoint": 401}
    one = motor(HIP, 1, codec="odrive", model="S1", options=options)
    with served(robot_file(one, motor(KNEE, 2, codec="odrive", model="S1")), "virtual") as (file, line):
        talk(file, line)


def test_moteus_over_fd() -> None:
    pytest.importorskip("moteus")
    options = {"kp_nm_per_turn": 800.0, "kd_nm_s_per_turn": 60.0, "torque_nm": 100.0}
    one = motor(HIP, 1, codec="moteus", model="r4", options=options)
    with served(robot_file(one), "virtual") as (file, line):
        talk(file, line)


def talk(file, line) -> None:
    bus = CanBus(file, "bus", G1)
    bus.link.open()
    try:
        for one in bus.motors:
            prepare(bus, one, file.watchdog_s)
            assert bus.joint_pos_rad(one) == pytest.approx(G1.default_pos_rad[index(one.joint)], abs=0.01)
        for one in bus.motors:
            switch_on(bus, one)
        assert all(one.enabled for one in line.motors)
        for one in bus.motors:
            switch_off(bus, [one])
        assert not any(one.enabled for one in line.motors)
        assert bus._demultiplexer.not_understood == 0
    finally:
        bus.close()


def test_an_adapter_that_vanishes_is_an_error_in_words() -> None:
    with served(robot_file(motor(HIP, 1)), "socketcand") as (file, line):
        bus = CanBus(file, "bus", G1)
        bus.link.open()
        line._faults.add("reconnect", "bus", duration_s=1.0)
        end_s = time.monotonic() + 5.0
        with pytest.raises(DeviceError, match=r"bus bus: cannot (send|receive)"):
            while time.monotonic() < end_s:
                ask(bus, bus.motors[0], bus.motors[0].codec.request_state(), lambda _: True, tries=1)
        while time.monotonic() < end_s:
            try:
                bus.link.open()
                prepare(bus, bus.motors[0], 0.2)
                break
            except DeviceError:
                time.sleep(0.1)
        assert bus.motors[0].complete
        bus.close()


def test_an_adapter_that_takes_seconds_to_open_holds_up_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """A round that waited for it would look like a wire process that hangs."""
    with served(robot_file(motor(HIP, 1)), "socketcand") as (file, _):
        opened = hal.can.link._opened
        monkeypatch.setattr(hal.can.link, "_opened", lambda **given: (time.sleep(0.8), opened(**given))[1])
        link = CanLink("bus", CanBus(file, "bus", G1).entry.arguments)
        longest_s, begun_s = 0.0, time.monotonic()
        while not link.is_open and time.monotonic() - begun_s < 10.0:
            before_s = time.monotonic()
            with contextlib.suppress(DeviceError):
                link.look_for()
            longest_s = max(longest_s, time.monotonic() - before_s)
            time.sleep(0.01)
        assert link.is_open and longest_s < 0.4 and time.monotonic() - begun_s > 0.8
        link.close()


def test_nobody_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    link = CanLink("leg", {"interface": "socketcand", "host": "127.0.0.1", "port": port, "channel": "can0"})
    begun_s = time.monotonic()
    with pytest.raises(DeviceError, match="bus leg: cannot open socketcand can0"):
        link.open()
    assert time.monotonic() - begun_s < 5.0
    missing = CanLink("leg", {"interface": "socketcan", "channel": "can77", "bitrate": 1_000_000})
    with pytest.raises(DeviceError, match="bus leg: cannot open socketcan can77"):
        missing.open()


def test_the_daemon_understands_only_frames() -> None:
    assert parse_send("123", "2", ["1", "ff"]) == Frame(0x123, b"\x01\xff")
    assert parse_send("00000123", "0", []) == Frame(0x123, b"", True)
    for identifier, length, data in (
        ("123", "3", ["1", "2"]),
        ("12", "0", []),
        ("FFF", "0", []),
        ("FFFFFFFF", "0", []),
        ("123", "1", ["100"]),
        ("123", "1", ["x"]),
        ("123", "9", ["0"] * 9),
        ("-12", "0", []),
    ):
        assert parse_send(identifier, length, data) is None
    assert frame_text(Frame(0x12, b"\xab")).startswith("< frame 012 ")
    assert frame_text(Frame(0x12, b"\xab", True)).endswith(" AB >")


def test_garbage_does_not_end_the_daemon() -> None:
    server = SocketcandServer()
    rng = np.random.default_rng(0)
    host, port = server.endpoint.split("//")[1].split("/")[0].split(":")
    client = socket.create_connection((host, int(port)))
    try:
        for _ in range(200):
            client.sendall(bytes(rng.integers(0, 256, 300, dtype=np.uint8)))
            assert receive(server, 0.001) == []
        client.sendall(b">< open can0 >< rawmode >< send 123 1 7 >")
        end_s, frames = time.monotonic() + 5.0, []
        while not frames and time.monotonic() < end_s:
            frames = receive(server, 0.05)
        assert frames == [Frame(0x123, b"\x07")]
    finally:
        client.close()
        server.close()


def receive(server: SocketcandServer, wait_s: float) -> list[Frame]:
    return server.receive(select.select(server.files, (), (), wait_s)[0])


def test_serial_lines() -> None:
    for frame in (Frame(0x12, b"\x01\x02"), Frame(0x1FFFFFFF, bytes(8), True), Frame(0x7FF)):
        assert parse_slcan(slcan_line(frame).decode().strip()) == frame
    for text in ("t", "t12", "t1232AB", "t1231ABCD", "tXYZ0", "T0000012", "t1239" + "00" * 9):
        assert parse_slcan(text) is None
