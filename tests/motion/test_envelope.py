"""The range of what motions ask for, and where another leaves it."""

import dataclasses

import numpy as np
import pytest

from motion.envelope import TRAINED_ON, envelope_from, envelope_of, novelty
from motion.library import open_motion
from motion.reference import build_reference
from robot.robot import load_robot

ROBOT = load_robot()
KICK = build_reference(open_motion("side_kick", ROBOT), ROBOT)
STAND = build_reference(open_motion("stand", ROBOT), ROBOT)


def test_the_range_is_that_of_all_motions():
    envelope = envelope_of([KICK, STAND], ROBOT)
    knee = ROBOT.joint_names.index("left_knee_joint")
    both = np.concatenate([KICK.joint_pos_rad[:, knee], STAND.joint_pos_rad[:, knee]])
    assert envelope["left_knee_joint"] == pytest.approx((both.min(), both.max()))
    speed = np.abs(KICK.joint_vel_rad_s[:, knee]).max()
    assert envelope["left_knee_joint speed"][1] == pytest.approx(speed)
    assert envelope["height"][1] == pytest.approx(max(KICK.root_pos_w[:, 2].max(), STAND.root_pos_w[:, 2].max()))
    assert 0.0 <= envelope["tilt"][0] < envelope["tilt"][1] < 0.6
    assert len(envelope) == 2 * ROBOT.num_joints + 5


def test_a_motion_is_within_its_own_range_and_a_kick_is_beyond_standing():
    assert novelty(KICK, ROBOT, envelope_of([KICK], ROBOT)).share == 0.0
    beyond = novelty(KICK, ROBOT, envelope_of([STAND], ROBOT))
    assert beyond.share > 0.5


def test_the_worst_quantity_is_named_with_its_bound():
    bent = STAND.joint_pos_rad.copy()
    wrist = ROBOT.joint_names.index("left_elbow_joint")
    bent[:100, wrist] += 0.5  # of 1001 ticks
    envelope = {name: (low - 1.0, high + 1.0) for name, (low, high) in envelope_of([STAND], ROBOT).items()}
    rest = float(STAND.joint_pos_rad[0, wrist])
    envelope["left_elbow_joint"] = (rest - 1.0, rest + 0.3)  # a range of 1.3 rad, and 5 % of it beyond do not count
    found = novelty(dataclasses.replace(STAND, joint_pos_rad=bent), ROBOT, envelope)
    assert found.share == pytest.approx(100 / 1001)
    assert found.worst == f"left_elbow_joint {rest + 0.5:.2f}, known up to {rest + 0.3:.2f}"
    envelope["left_elbow_joint"] = (rest - 1.0, rest + 0.45)
    assert novelty(dataclasses.replace(STAND, joint_pos_rad=bent), ROBOT, envelope).share == 0.0


@pytest.mark.parametrize(
    "provenance", [{}, {TRAINED_ON: None}, {TRAINED_ON: {"height": [1.0]}}, {TRAINED_ON: {"height": ["a", 2]}}]
)
def test_an_actor_that_does_not_say_what_it_knows_knows_nothing(provenance):
    assert envelope_from(provenance) is None
    assert envelope_from({TRAINED_ON: {"height": [0.5, 0.8]}}) == {"height": (0.5, 0.8)}
