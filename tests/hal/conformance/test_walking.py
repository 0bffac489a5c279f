"""A whole run over every wire, judged at its far end: nothing is asked for that a motor could not or must not give.

What is judged, by the emulator's own devices (`hal.emulator.checks`): numbers that are not finite, gains outside the
protocol's range, torque beyond the joint's limit as predicted from what the device itself reported last.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hal.emulator.checks import ROUNDING_NM, TORQUE_SLACK
from hal.open import WIRES
from tests.hal.rigs import G1

pytestmark = pytest.mark.real_time

ROOT = Path(__file__).resolve().parents[3]
LIMIT_S = 240.0
ATTEMPTS = 3
STALE = "fault: stale"


@pytest.mark.parametrize("wire", WIRES)
def test_a_whole_run_asks_for_nothing_that_a_motor_must_not_give(wire: str, punctual: None, tmp_path: Path) -> None:
    if wire == "dds":
        pytest.importorskip("cyclonedds")
    result = tmp_path / "run.json"
    command = [sys.executable, "-P", str(ROOT / "deploy" / "run"), "--backend", wire, "--emulate"]
    command += ["--policy", "taichi", "--json", str(result)]
    for _ in range(ATTEMPTS):  # a machine that is late trips the loop, and is no reason to ask for anything forbidden
        run = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        assert result.exists(), f"{run.stdout[-2000:]}\n{run.stderr}"
        judged = json.loads(result.read_text())["wire"]["emulator"]["violations"]
        assert judged["counts"] == {}, judged["listed"]
        if STALE not in run.stderr:
            break
    assert run.returncode == 0, f"{run.stdout[-2000:]}\n{run.stderr}"
    assert set(judged["worst_torque"]) == set(G1.joint_names)
    # The robot carries itself: every leg has been asked for a torque, and none for more than it has.
    worst = {name: judged["worst_torque"][name] for name in G1.joint_names}
    assert all(worst[name] > 0.05 for name in G1.joint_names if "knee" in name or "hip_pitch" in name), worst
    allowed = TORQUE_SLACK + ROUNDING_NM / G1.torque_limit_nm
    assert all(worst[name] <= allowed[joint] for joint, name in enumerate(G1.joint_names)), worst
