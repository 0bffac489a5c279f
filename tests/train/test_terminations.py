"""When an episode has failed, at distances worked out by hand."""

import math
from dataclasses import replace

import pytest
import torch

from tests.train.test_rewards import on_reference
from train.mdp.terminations import TERMINATIONS


def standing(pos=(0.0, 0.0, 0.0), pitch_rad=0.0, ground_m=0.0):
    """A pelvis that is off its reference, which is upright at the origin; what lies under it."""
    t = on_reference()
    half = 0.5 * pitch_rad
    quat = torch.tensor([[math.cos(half), 0.0, math.sin(half), 0.0]])
    physics = replace(t.physics, root_pos_w=torch.tensor([pos]), root_quat_wxyz=quat)
    return replace(t, physics=physics, ground_m=torch.tensor([ground_m]))


@pytest.mark.parametrize(
    ("name", "limit", "inside", "outside"),
    [
        # The projected gravities of two poses that are a apart differ by 2 sin(a/2): 0.8 at 0.823 rad.
        ("tilt_error", {"limit": 0.8}, standing(pitch_rad=0.82), standing(pitch_rad=0.83)),
        ("height", {"min_m": 0.3}, standing((0.0, 0.0, 0.71), ground_m=0.4), standing((0.0, 0.0, 0.69), ground_m=0.4)),
        ("height", {"min_m": 0.3}, standing((0.0, 0.0, -0.6), ground_m=-1.0), standing((0.0, 0.0, 0.1))),
        ("height_error", {"limit_m": 0.3}, standing((9.0, 9.0, -0.29)), standing((0.0, 0.0, -0.31))),
        ("height_error", {"limit_m": 0.3}, standing((9.0, 9.0, 0.29)), standing((0.0, 0.0, 0.31))),
        ("place_error", {"limit_m": 0.5}, standing((0.3, 0.39, 9.0)), standing((0.3, 0.41, 0.0))),
    ],
)
def test_beyond_the_limit_and_not_before(name, limit, inside, outside):
    assert TERMINATIONS[name](inside, **limit).tolist() == [False]
    assert TERMINATIONS[name](outside, **limit).tolist() == [True]
