"""The command `hal/verify` on every wire, as an owner types it; the emulator's own truth is what the operator sees."""

import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hal.emulator.launch import Emulator
from hal.open import WIRES
from hal.verification import cli
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
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert cli.main(options) == 2
    assert set(running.get(wire, running.config(wire)).control.status()["mode"].values()) == {"slack"}
    assert list(tmp_path.iterdir()) == []
