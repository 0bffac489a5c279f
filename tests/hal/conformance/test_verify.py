"""The command `hal/verify` on every wire, as an owner types it; the emulator's own truth is what the operator sees.

And the run that wants its record: a robot that nobody has verified stays slack.
"""

import contextlib
import json
import os
import pty
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import deploy.record.watching
import deploy.session
from core.clock import MonotonicClock
from deploy.cli import main as deploy_run
from hal.emulator.launch import Emulator
from hal.open import WIRES, open_backend, wire_config_sha256
from hal.verification import cli
from hal.verification.record import VerifiedRecord
from tests.deploy.test_wires import patient_settings
from tests.deploy.toys import write_standing_actor
from tests.hal.conformance.rigs import Emulators
from tests.hal.rigs import G1
from tests.hal.verification.rig import Watcher

pytestmark = pytest.mark.real_time

LIFT_M = 0.12


class Onlooker(Watcher):
    """Looks at an emulator in another process."""

    def __init__(self, emulator: Emulator) -> None:
        super().__init__()
        self._control = emulator.control

    def truth_rad(self) -> np.ndarray:
        seen = self._control.status()["joint_pos_rad"]
        return np.array([seen[name] for name in G1.joint_names])

    def push(self, forwards_rad: float, left_rad: float) -> None:
        self._control.lean(forwards_rad=forwards_rad, left_rad=left_rad)


@pytest.fixture
def options(wire: str, running: Emulators, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    monkeypatch.setattr(cli, "RECORDS", tmp_path)
    config = running.config(wire)
    endpoints = running.get(wire, config).endpoints
    yield ["--backend", wire, "--hal-config", str(config), *(f"--at={name}={at}" for name, at in endpoints.items())]


@pytest.mark.parametrize("wire", WIRES)
def test_the_robot_that_the_files_describe_is_verified(
    wire: str, running: Emulators, options: list[str], tmp_path: Path
) -> None:
    emulator = running.get(wire, running.config(wire))
    emulator.control.reset(lift_m=LIFT_M)
    operator = Onlooker(emulator)
    assert cli.main(options, operator=operator) == 0
    assert [name for name in operator.asked if name in G1.joint_names] == list(G1.joint_names)
    status = emulator.control.status()
    assert set(status["mode"].values()) == {"slack"}
    assert not status["violations"]["counts"] and max(status["violations"]["worst_torque"].values()) < 0.2
    (record,) = tmp_path.iterdir()
    known = json.loads(record.read_text())["identities"]
    assert len(known) == {"dds": 1, "can": 23, "dynamixel": 0}[wire]


@pytest.mark.parametrize("wire", ["can"])
def test_an_operator_who_does_not_agree_has_nothing_energised(
    wire: str, running: Emulators, options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys, terminal = pty.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        ended = threading.Event()

        def say_no() -> None:
            while not ended.wait(0.2):
                os.write(keys, b"no\n")

        answering = threading.Thread(target=say_no)
        answering.start()
        assert cli.main(options) == 2
        ended.set()
        answering.join()
    os.close(keys)
    assert set(running.get(wire, running.config(wire)).control.status()["mode"].values()) == {"slack"}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("wire", WIRES)
def test_a_run_on_a_robot_that_nobody_has_verified_is_refused(
    wire: str, running: Emulators, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """To the run the emulator is a real robot. Dry runs are not what is asked about."""
    config = running.config(wire)
    emulator = running.get(wire, config)
    there = {"config": config, "endpoints": emulator.endpoints}
    records, opened = tmp_path / "verified", open_backend
    monkeypatch.setattr(deploy.record.watching, "INCIDENTS", tmp_path / "incidents")
    monkeypatch.setattr(deploy.session, "VERIFIED", records)
    monkeypatch.setattr(deploy.session, "require_records", lambda *parts: None)
    monkeypatch.setattr(deploy.session, "open_backend", lambda *parts, **named: opened(*parts, **named | there))
    (tmp_path / "patient.yaml").write_text(patient_settings())
    policy, stand = (str(write_standing_actor(tmp_path / f"{name}.onnx", name=name)) for name in ("clip", "stand"))
    command = ["--backend", wire, "--hal-config", str(config), "--config", str(tmp_path / "patient.yaml")]
    command += ["--policy", policy, "--stand", stand, "--duration", "0.3"]
    assert deploy_run(command) == 4
    assert "verified: not verified with this configuration: hang the robot up" in capsys.readouterr().err
    with contextlib.closing(open_backend(wire, G1, MonotonicClock(), **there)) as backend:
        known = dict(backend.open().identities)
    record = VerifiedRecord(wire_config_sha256(wire, config, {}), G1.name, known)
    record.save(records, {})
    assert deploy_run(command) in (0, 3)  # a machine that is late may trip what has begun
    assert "ok  verified" in capsys.readouterr().out
    VerifiedRecord(record.config_sha256, G1.name, known | {"left_knee_joint": "another"}).save(records, {})
    assert deploy_run(command) == 4
    assert "another robot than the verified one: left_knee_joint is" in capsys.readouterr().err
    assert set(emulator.control.status()["mode"].values()) == {"slack"}
