import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from core.errors import InputError
from hal.contract.types import DeviceError
from hal.emulator.control import ControlClient
from hal.emulator.launch import launch_emulator, start_emulator

ROOT = Path(__file__).resolve().parents[3]
WIRELESS = """
import sys
from hal.emulator import cli, device
device.DEVICES["wireless"] = ("tests.hal.emulator.rig", "WirelessDevice")
sys.exit(cli.main(sys.argv[1:]))
"""


@pytest.fixture(autouse=True)
def here(monkeypatch):
    monkeypatch.chdir(ROOT)


def command(*arguments):
    return [sys.executable, "-c", WIRELESS, "wireless", "--lifeline", *arguments]


def wait_for(condition, limit_s=20.0):
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


@pytest.mark.real_time
def test_an_emulator_runs_in_a_process_of_its_own_and_ends_soon():
    with start_emulator(command("--config", "conf", "--fault", "silence:bus0@30")) as emulator:
        assert emulator.endpoints == {"bus0": "conf://here"}
        assert emulator.pid != os.getpid() and alive(emulator.pid)
        emulator.control.release_gantry()
        assert emulator.control.status()["faults"][0]["active"] is False
        begin_s = time.monotonic()
    assert time.monotonic() - begin_s < 2.0
    assert not alive(emulator.pid)
    emulator.stop()


@pytest.mark.real_time
def test_a_stopped_emulator_ends_all_the_same():
    emulator = start_emulator(command())
    os.kill(emulator.pid, signal.SIGSTOP)
    begin_s = time.monotonic()
    emulator.stop()
    assert time.monotonic() - begin_s < 2.5 and not alive(emulator.pid)


def test_it_ends_when_told_over_the_control_socket():
    with start_emulator(command()) as emulator:
        emulator.control.quit()
        assert emulator._process.wait(20.0) == 0
        with pytest.raises(DeviceError, match="emulator at"):
            emulator.control.status()


def test_refused_options_are_the_users_error():
    with pytest.raises(InputError, match="hiccup"):
        start_emulator(command("--fault", "hiccup"))
    with pytest.raises(InputError, match="smoke"):
        launch_emulator("smoke")


def test_an_emulator_that_cannot_start_says_why():
    with pytest.raises(DeviceError, match="no such luck"):
        start_emulator([sys.executable, "-c", "import sys; sys.exit('no such luck')"])


def test_it_outlives_a_killed_starter_only_for_the_time_that_damping_takes():
    starter = textwrap.dedent(f"""
        import json, time
        from hal.emulator.launch import start_emulator
        emulator = start_emulator({command()!r})
        print(json.dumps([emulator.pid, emulator.control.address]), flush=True)
        time.sleep(60)
    """)
    process = subprocess.Popen([sys.executable, "-c", starter], stdout=subprocess.PIPE)
    pid, address = json.loads(process.stdout.readline())
    with ControlClient(address) as client:
        process.kill()
        process.wait()
        process.stdout.close()
        time.sleep(0.5)
        assert client.status()["gantry_attached"]
    wait_for(lambda: not alive(pid))


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
