"""What a run says of itself to those who look on."""

import json
import socket
import time
import urllib.error
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.control.timing import PhaseTimer
from deploy.record.status import Status, StatusLine, line
from deploy.record.status_server import StatusServer
from deploy.safety.guard import Guard
from tests.deploy.toys import KNEE, PERIOD_S, ROBOT, SETTINGS, state, with_joint


def shown(reading, statistics=None):
    tick = Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    status = Status(ROBOT, None if statistics is None else lambda: statistics)
    status(reading, tick(reading), PhaseTimer())
    return status


def ask(url):
    with urllib.request.urlopen(url, timeout=5) as answer:
        return answer.headers["Content-Type"], answer.read().decode()


def test_json_and_text_over_loopback():
    """Half of the left knee's 139 Nm; 60 C at its motor, one motor without a sensor; the IMU's value 30 ms old."""
    heat = np.full(ROBOT.num_joints, 35.0)
    heat[KNEE], heat[0] = 60.0, np.nan
    reading = with_joint("joint_torque_nm", -69.5, temperature_c=heat, imu_age_s=0.03)
    wire = {"cycles": {"left_leg": {"rounds": 7, "overruns": 1, "failures": 0}}, "stats": {"battery charge %": 83.0}}
    with StatusServer(shown(reading, wire), 0) as server:
        kind, body = ask(server.address + "json")
        assert kind.startswith("application/json")
        content = json.loads(body)
        assert content["mode"] == "IDLE" and content["trip"] is None and content["overruns"] == 0
        assert content["torque_share"]["left_knee_joint"] == 0.5 and content["temperature_c"]["left_knee_joint"] == 60.0
        assert content["temperature_c"][ROBOT.joint_names[0]] is None
        assert content["age_ms"] == {"joints": 0.0, "imu": pytest.approx(30.0)}
        assert content["battery"] == {"charge %": 83.0} and content["wire"]["cycles"] == wire["cycles"]
        kind, body = ask(server.address)
        assert kind.startswith("text/plain")
        assert body.splitlines()[0] == (
            "IDLE   hottest left_knee_joint 60 C   torque left_knee_joint 50 %   "
            "age joints 0.0 ms, imu 30.0 ms   overruns 0 of 0   battery charge % 83"
        )
        assert len(body.splitlines()) == 1 + ROBOT.num_joints
        with pytest.raises(urllib.error.HTTPError, match="404"):
            ask(server.address + "etc/passwd")


def test_the_minutes_that_a_motor_has_left_at_its_load_of_late():
    """Half of the left knee's 139 Nm for 300 s, ten time constants of its winding, at a housing of 40 C.

    The winding is a quarter of 225 K warmer, 96.25 C. The housing goes to 30 + 337.5 / 4 = 114.375 C, by 900 s. At
    115 - 56.25 = 58.75 C of it the rule trips: after 900 ln((114.375 - 40) / (114.375 - 58.75)) = 261.4 s.
    """
    tick = Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), guard := Guard(ROBOT, SETTINGS, PERIOD_S))
    status = Status(ROBOT, None, guard.winding)
    reading = with_joint("joint_torque_nm", -69.5, temperature_c=np.full(ROBOT.num_joints, 40.0))
    for time_s in (0.0, 300.0):
        status(reading, tick(replace(reading, time_s=time_s)), PhaseTimer())
    content = json.loads(json.dumps(status.content()))
    assert content["winding_c"]["left_knee_joint"] == pytest.approx(96.25, abs=0.01)
    assert content["winding_c"]["right_knee_joint"] == 40.0 and content["minutes_left"]["right_knee_joint"] is None
    assert content["minutes_left"]["left_knee_joint"] == pytest.approx(261.4 / 60.0, abs=0.01)
    assert "left_knee_joint too hot in 4 minutes" in line(content)
    assert "too hot" not in line(shown(reading).content())


def test_a_trip_and_a_device_fault_are_in_it():
    content = shown(state(faults=("motor_fault:waist_yaw_joint: overload",))).content()
    assert content["device_faults"] == ["motor_fault:waist_yaw_joint: overload"]
    assert line(content).startswith("IDLE   fault device_fault: motor_fault:waist_yaw_joint: overload")


def test_it_listens_on_loopback_only_and_a_taken_port_is_refused():
    with StatusServer(Status(ROBOT), 0) as server:
        host, port = server._server.server_address
        assert host == "127.0.0.1"
        assert json.loads(ask(server.address + "json")[1])["mode"] is None
        with pytest.raises(InputError, match=rf"--status {port}: no status can be offered \(Address already in use\)"):
            StatusServer(Status(ROBOT), port)
    with pytest.raises(InputError, match="--status 70000"):
        StatusServer(Status(ROBOT), 70000)


def test_a_caller_that_holds_the_line_delays_neither_the_loop_nor_the_end():
    status = shown(state())
    begun_s = time.monotonic()
    with StatusServer(status, 0) as server, socket.create_connection(server._server.server_address) as caller:
        caller.sendall(b"GET / HT")
        time.sleep(0.1)
        tick = Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
        spent_s = time.perf_counter()
        for _ in range(100):
            status(state(), tick(state()), PhaseTimer())
        assert time.perf_counter() - spent_s < 1.0
    assert time.monotonic() - begun_s < 5.0


def test_the_line_comes_every_so_many_ticks():
    said, status = [], shown(state())
    tick = Tick(StateMachine(ROBOT, None, [], SETTINGS, PERIOD_S), Guard(ROBOT, SETTINGS, PERIOD_S))
    lines = StatusLine(status, 50, said.append)
    for _ in range(149):
        lines(state(), tick(state()), PhaseTimer())
    assert len(said) == 2 and said[0].startswith("IDLE   hottest")
