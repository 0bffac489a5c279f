"""The end of steering: what the actor is shown so that the stand actor can take over."""

import math

import numpy as np
import pytest

from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.open import standing_for
from deploy.goals.steering import SteerGoal
from policy.goals import visible_in
from tests.deploy.goals.toys import Hand, column
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, state


def turned(yaw_rad):
    return state(imu_quat_wxyz=np.array([math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)]))


@pytest.mark.parametrize("ends", ["rests", "hold", "lost"])
def test_left_to_the_stand_actor_it_is_shown_the_whole_pose_of_that_one_in_the_heading_asked_for(actors, ends):
    """A second of a turn to the left; then it comes to rest, and looks as the stand actor's clip does at first."""
    hand, stand = Hand(), load_run(actors / "stand.onnx", None, ROBOT, SETTINGS.entry)
    actor = load_run(actors / "goals.onnx", "stand", ROBOT, SETTINGS.entry).actor
    standing = standing_for(actor.spec, stand, ROBOT)
    guard = GoalGuard(SETTINGS.goals, PERIOD_S)
    run = ActorRun(actor, ROBOT, SETTINGS.entry, SteerGoal("stick", hand, standing, guard))
    run.start()
    hand.steer = Steer(0.0, 0.0, 0.4)
    for _ in range(50):
        run.act(turned(0.7))
    hand.steer = Steer(0.4, 0.0, 0.0) if ends == "hold" else NOBODY if ends == "lost" else Steer(0.0, 0.0, 0.0)
    if ends == "hold":
        run.give_way()
    run.act(turned(0.7))
    assert np.array_equal(run.goal.visible, visible_in("steer"))  # it still turns
    for _ in range(160):
        seen = run.act(turned(0.7)).observation["obs"]
    assert np.array_equal(run.goal.visible, visible_in("full")) and run.resting
    angle = guard.heading_rad
    assert angle > 0.3 and seen[column("reference_heading")] == pytest.approx([math.sin(angle), math.cos(angle)])
    assert seen[column("reference_joint_pos")][:23] == pytest.approx(standing.joint_pos_rad[0] - ROBOT.default_pos_rad)
    assert seen[column("reference_feedforward")] == pytest.approx(standing.feedforward_rad[0])
    assert standing.feedforward_rad[0].any() and not seen[column("reference_lin_vel")].any()
    point = np.array(seen[column("goal_point", "head")][:2])
    assert np.hypot(*point) == pytest.approx(np.hypot(*head_of(standing)), abs=1e-6)
    hand.steer = Steer(0.4, 0.0, 0.0)
    run.act(turned(0.7))
    assert np.array_equal(run.goal.visible, visible_in("steer" if ends == "rests" else "full"))


def head_of(standing):
    """(2,) from above the root, of the first pose."""
    head = ROBOT.tracked_names.index("head_link")
    return (standing.body_pos_w[0, head] - standing.root_pos_w[0])[:2]
