"""benchmarks/tracker_protocol.py: BeyondMimic's rewards by hand, and a robot that cannot follow."""

import json
import math
from types import SimpleNamespace

import pytest
import torch

from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate
from motion.clip import save_clip
from tests.sim2sim.toys import standing_clip, write_still_actor
from tests.train.programs import load

UP = torch.tensor([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def protocol():
    return load("tracker_protocol")


def outcome(turn_rad=0.0, shift=(0.0, 0.0, 0.0), speed=0.0):
    """Three bodies, the middle one the anchor; the robot is the reference turned about the vertical and shifted."""
    ref_pos = torch.tensor([[[0.0, 0.0, 0.7], [0.1, 0.0, 1.0], [0.3, 0.2, 1.2]]])
    quat = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(1, 3, 4)
    turn = quat_from_axis_angle(UP, torch.tensor(turn_rad)).expand(1, 3, 4)
    zeros = torch.zeros(1, 3, 3)
    bodies = SimpleNamespace(
        pos_w=quat_rotate(turn, ref_pos) + torch.tensor(shift), quat_wxyz=quat_mul(turn, quat),
        lin_vel_w=zeros + torch.tensor([speed, 0.0, 0.0]), ang_vel_w=zeros,
    )  # fmt: skip
    reference = SimpleNamespace(body_pos_w=ref_pos, body_quat_wxyz=quat, body_lin_vel_w=zeros, body_ang_vel_w=zeros)
    return SimpleNamespace(bodies=bodies, reference=reference)


def test_a_perfect_robot_gets_all_of_it(protocol):
    assert protocol.rewards(outcome(), 1)[0].tolist() == pytest.approx([0.5, 0.5, 1.0, 1.0, 1.0, 1.0])


def test_each_term_by_hand(protocol):
    """Turned and moved on the ground, bodies stand to their anchor as they should; a height is seen in them."""
    turned = protocol.rewards(outcome(turn_rad=0.4, shift=(0.3, 0.0, 0.0)), 1)[0]
    place = torch.tensor([0.1 * (math.cos(0.4) - 1.0) + 0.3, 0.1 * math.sin(0.4)]).square().sum()
    expected = [0.5 * math.exp(-float(place) / 0.09), 0.5 * math.exp(-1.0), 1.0, 1.0, 1.0, 1.0]
    assert turned.tolist() == pytest.approx(expected, abs=1e-4)
    lower = protocol.rewards(outcome(shift=(0.0, 0.0, -0.15)), 1)[0]
    assert lower[2] == pytest.approx(math.exp(-0.25), abs=1e-5)
    fast = protocol.rewards(outcome(speed=2.0), 1)[0]
    assert fast[4] == pytest.approx(math.exp(-4.0), abs=1e-6)


def test_a_row_for_each_clip(protocol, tmp_path, capsys):
    """Standing is played to its end; a kick, by a robot that only stands, is lost before."""
    actor = write_still_actor(tmp_path / "still.onnx", any_clip=True)
    save_clip(standing_clip(0.3), tmp_path / "brief.npz")
    scores = tmp_path / "scores.json"
    given = ["--policy", str(actor), "--motion", str(tmp_path / "brief.npz"), "--motion", "side_kick"]
    assert protocol.main([*given, "--json", str(scores)]) == 0
    told = json.loads(scores.read_text())
    brief, kick = told["clips"]["brief"], told["clips"]["side_kick"]
    assert brief["lost"] == 0.0 and brief["length"] == 1.0 and 0.8 < brief["return"] <= 1.0
    assert kick["lost"] == 1.0 and 0.05 < kick["length"] < 0.9 and kick["return"] < kick["length"]
    assert "1 of 2" in capsys.readouterr().out
    assert protocol.main(["--policy", str(actor), "--motion", "no_such"]) == 2
