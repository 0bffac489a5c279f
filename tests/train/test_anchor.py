"""References that come after their robots."""

import math

import numpy as np
import pytest
import torch

from core.errors import InputError
from core.rotations import quat_rotate, yaw_of
from tests.train.worlds import g1, settings, small_env, swaying_reference
from train.mdp.anchor import Anchor
from train.mdp.tick import ReferenceRows, ReferenceTable

DT_S = 0.02
QUARTER_TURN = torch.tensor([[math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]])


def rows_of_a_sway() -> ReferenceRows:
    reference = swaying_reference(g1())
    table = ReferenceTable([reference], [np.zeros(reference.num_ticks + 1)], "cpu")
    return table.rows(torch.tensor([0]), torch.tensor([13]))


def test_a_reference_without_a_lag_stands_where_its_robot_does():
    rows = rows_of_a_sway()
    anchor = Anchor(DT_S, DT_S, "cpu")
    place = anchor.at_start(1)
    for turns, x_m in ((1, 1.5), (2, 3.0)):
        moved = anchor.moved(rows, place)
        heading = math.pi / 2 * turns
        place = anchor.followed(
            place,
            torch.tensor([[x_m, -2.0, 0.4]]),
            torch.tensor([[math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2)]]),
            moved,
        )
        there = anchor.moved(rows, place)
        assert torch.allclose(there.root_pos_w, torch.tensor([[x_m, -2.0, 0.78]]), atol=1e-6)
        assert math.isclose(abs(yaw_of(there.root_quat_wxyz).item()), heading, abs_tol=1e-6)


def test_the_whole_reference_is_moved_as_one_body():
    rows = rows_of_a_sway()
    rows = ReferenceRows(**vars(rows) | {"root_lin_vel_w": torch.tensor([[1.0, 0.0, 0.2]])})
    anchor = Anchor(DT_S, DT_S, "cpu")
    place = anchor.at_start(1)
    place = anchor.followed(place, torch.tensor([[3.0, 0.0, 0.78]]), QUARTER_TURN, rows)
    moved = anchor.moved(rows, place)
    kinematics = g1().kinematics
    still = torch.zeros(1, 3)
    turned = kinematics.forward(
        moved.root_pos_w, moved.root_quat_wxyz, moved.joint_pos_rad, still, still, moved.joint_vel_rad_s
    )
    assert torch.allclose(moved.body_pos_w, turned.pos_w, atol=1e-5)
    assert torch.allclose((moved.body_quat_wxyz * turned.quat_wxyz).sum(-1).abs(), torch.ones(1, 27), atol=1e-5)
    assert torch.allclose(moved.root_lin_vel_w, torch.tensor([[0.0, 1.0, 0.2]]), atol=1e-6)
    for name in ("body_lin_vel_w", "body_ang_vel_w", "root_ang_vel_w"):
        assert torch.allclose(getattr(moved, name), quat_rotate(QUARTER_TURN, getattr(rows, name)), atol=1e-5)


def test_the_gap_shrinks_with_the_time_constant():
    rows = rows_of_a_sway()
    anchor = Anchor(1.0, DT_S, "cpu")
    place = anchor.at_start(1)
    for _ in range(50):
        place = anchor.followed(place, torch.tensor([[0.2, 0.0, 0.78]]), QUARTER_TURN, anchor.moved(rows, place))
    left = (1 - DT_S) ** 50
    moved = anchor.moved(rows, place)
    assert torch.allclose(moved.root_pos_w, torch.tensor([[0.2 * (1 - left), 0.0, 0.78]]), atol=1e-5)
    assert math.isclose(yaw_of(moved.root_quat_wxyz).item(), math.pi / 2 * (1 - left), rel_tol=1e-4)


@pytest.mark.parametrize("time_s", [None, 0.1])
def test_a_robot_moved_aside_is_forgiven_within_the_time_constant(time_s):
    env = small_env(1, seconds=5.0, anchor_time_s=time_s, termination={"terms": {}})
    state = env.simulator.state()
    qpos = torch.cat([state.root_pos_w + torch.tensor([1.0, 0.0, 0.0]), state.root_quat_wxyz, state.joint_pos_rad], 1)
    env.simulator.reset(torch.tensor([0]), qpos, torch.zeros(1, 29))
    for _ in range(25):
        env.step(torch.zeros(1, env.num_actions))
    away_m = env.state.position_error_m[0, 0, 0].item()
    assert abs(away_m - 1.0) < 0.1 if time_s is None else abs(away_m) < 0.1
    env.reset()
    assert env.state.place.place_m.abs().max() == 0.0


def test_a_reference_cannot_come_in_no_time():
    with pytest.raises(InputError, match="anchor_time_s"):
        settings(anchor_time_s=0.0)
