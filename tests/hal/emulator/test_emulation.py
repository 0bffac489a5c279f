import json
import os
import pty
import socket
import threading
import time

import numpy as np
import pytest

from core.errors import InputError
from hal.contract.types import DeviceError
from hal.emulator import cli, device
from hal.emulator.control import ControlClient
from hal.emulator.device import Worker, device_class, fault_kinds
from hal.emulator.emulation import Emulation
from hal.emulator.faults import EmulatedFault
from hal.emulator.keyboard import FAULT_OF_KEY, OTHER_KEYS, FaultKeys
from tests.hal.emulator.rig import G1, WirelessDevice

KNEE = "left_knee_joint"


@pytest.fixture(autouse=True)
def wireless(monkeypatch):
    monkeypatch.setitem(device.DEVICES, "wireless", (WirelessDevice.__module__, WirelessDevice.__name__))


@pytest.fixture
def emulation():
    with Emulation("wireless", None, G1) as emulation:
        yield emulation


@pytest.fixture
def client(emulation):
    with ControlClient(emulation.ready()["control"]) as client:
        yield client


def wait_for(condition, limit_s=10.0):
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.01)


def test_it_says_where_it_is_and_ends_what_it_began():
    with Emulation("wireless", "conf", G1) as emulation:
        ready = emulation.ready()
        assert ready["emulator"] == "wireless" and ready["endpoints"] == {"bus0": "conf://here"}
        assert emulation.device.calls == ["start"]
    assert emulation.device.calls == ["start", "stop"]
    with pytest.raises(DeviceError):
        ControlClient(ready["control"])


def test_unknown_kinds_bad_configurations_and_bad_faults_are_refused_before_anything_is_opened():
    with pytest.raises(InputError, match="smoke"):
        Emulation("smoke", None, G1)
    with pytest.raises(InputError, match="bad configuration"):
        Emulation("wireless", "bad", G1)
    with pytest.raises(InputError, match="unknown key"):
        Emulation("wireless", None, G1, faults=[EmulatedFault("silence", "bus7")])
    Emulation("wireless", None, G1, faults=[EmulatedFault("sneeze", "bus0", 2.0)])


def test_a_wire_that_cannot_be_opened_leaves_nothing_running(monkeypatch):
    def refuse(self):
        raise OSError("address in use")

    monkeypatch.setattr(WirelessDevice, "start", refuse)
    emulation = Emulation("wireless", None, G1)
    with pytest.raises(OSError, match="address in use"), emulation:
        raise AssertionError("it started")
    assert emulation.device.calls == ["stop"]
    assert emulation.robot._thread is None


def test_every_kind_of_emulator_has_its_place():
    assert set(device.DEVICES) >= {"dds", "can", "dynamixel", "imu"}
    assert "sneeze" in fault_kinds(device_class("wireless")) and "silence" in fault_kinds(device_class("wireless"))


def test_the_gantry_is_released_over_the_control_socket(emulation, client):
    assert client.gantry_attached() and client.status()["gantry_attached"]
    client.release_gantry()
    wait_for(lambda: not client.gantry_attached())
    client.reset(start_noise_rad=0.02, seed=4)
    assert client.gantry_attached()
    assert emulation.device.calls == ["start", "reset"]


def test_status_is_the_truth_in_plain_data(emulation, client):
    status = client.status()
    assert status["kind"] == "wireless" and status["device"] == {"calls": ["start"]}
    assert list(status["joint_pos_rad"]) == list(G1.joint_names)
    assert np.linalg.norm(status["root_quat_wxyz"]) == pytest.approx(1.0)
    assert status["violations"]["counts"] == {} and status["told_s"][KNEE] is None


def test_faults_come_and_go_over_the_control_socket(emulation, client):
    client.fault("delay", "bus0", value=0.03)
    assert emulation.faults.value("delay", "bus0") == 0.03
    client.fault("silence", duration_s=60.0)
    assert [fault["kind"] for fault in client.status()["faults"]] == ["delay", "silence"]
    assert client.clear_fault("silence") == 1 and client.clear_fault() == 1
    with pytest.raises(InputError, match="hiccup"):
        client.fault("hiccup")


def test_after_a_late_answer_the_next_request_gets_its_own(emulation):
    """A request that takes too long is given up; what it would have been answered must not answer the next one."""
    handle, slow = emulation.control._handle, threading.Event()
    emulation.control._handle = lambda request: (request["do"] == "gantry" and slow.wait(60.0), handle(request))[1]
    with ControlClient(emulation.ready()["control"], timeout_s=0.5) as client:
        with pytest.raises(DeviceError, match="no answer to 'gantry'"):
            client.gantry_attached()
        slow.set()
        client.timeout_s = 30.0
        assert client.status()["kind"] == "wireless"
        assert client.gantry_attached()
    with pytest.raises(DeviceError, match="this client was closed"):
        client.status()


@pytest.mark.parametrize("line", [b"{", b"[]", b'{"do": 3}', b'{"do": "dance"}', b'{"do": "fault", "x": 1}', b"\xff"])
def test_nonsense_is_answered_and_does_no_harm(emulation, client, line):
    host, port = client.address.split(":")
    with socket.create_connection((host, int(port)), timeout=5.0) as raw, raw.makefile("rwb") as stream:
        stream.write(line + b"\n")
        stream.flush()
        answer = json.loads(stream.readline())
    assert answer["ok"] is False and answer["error"]
    assert client.gantry_attached()


def test_a_request_that_only_some_devices_know_is_refused_by_the_others(emulation, client):
    with pytest.raises(InputError, match="unknown request"):
        client.device(press="A")


def test_quit_is_heard(emulation, client):
    client.quit()
    wait_for(emulation.asked_to_quit.is_set, 1.0)


def test_keys_switch_faults_on_and_off_for_the_chosen_target(emulation, monkeypatch):
    keyboard, terminal = pty.openpty()
    monkeypatch.setattr("sys.stdin", os.fdopen(terminal, "r"))
    with FaultKeys(emulation) as keys:
        os.write(keyboard, b"s")
        assert keys.wait(1.0) == ["silence *: on"]
        assert emulation.faults.fate("bus0").lost
        os.write(keyboard, b"snt?b")
        assert keys.wait(1.0) == [
            "silence *: over",
            f"target {G1.joint_names[0]}",
            f"over_temperature {G1.joint_names[0]}: on",
            "release the gantry",
        ]
        assert emulation.faults.value("over_temperature", KNEE) is None
        assert keys.wait(0.0) == []
    os.close(keyboard)


def test_no_key_has_two_meanings():
    assert not set(FAULT_OF_KEY) & set(OTHER_KEYS)
    assert set(FAULT_OF_KEY.values()) <= set(fault_kinds(device_class("wireless")))


def test_the_command_line_refuses_in_one_line(capsys):
    for arguments in (
        ["smoke"],
        ["can", "--fault", "delay=soon"],
        ["can", "--seed", "x"],
        ["can", "--start-noise", "n"],
    ):
        assert cli.main(arguments) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: ") and said.count("\n") == 1


def test_a_worker_keeps_its_period_skips_what_it_missed_and_keeps_its_failure():
    calls = []

    def run(now_s):
        calls.append(now_s)
        if len(calls) == 3:
            time.sleep(0.1)
        if len(calls) == 6:
            raise RuntimeError("enough")

    worker = Worker("test", run, 0.01)
    worker.start()
    wait_for(lambda: worker.failure is not None)
    worker.stop()
    assert len(calls) == 6 and worker.skipped >= 8
    assert calls[3] - calls[2] >= 0.1
