"""What a clip shows an actor on a robot, through the loop, is what it showed in training."""

import numpy as np
import pytest
import torch

from core.clock import SimulatedClock
from deploy.actors import load_run
from deploy.cell import Cell
from motion.library import open_motion
from motion.reference import build_reference
from policy.goals import KINDS, bits_of
from tests.deploy.goals.toys import DIMS, GROUP, write_goal_actor
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, FakeBackend, state
from tests.train.worlds import settings
from train.mdp.factory import build_environment

TICKS = 30


def goal_columns():
    """Where what is told of the goal lies; before it lies what is measured."""
    measured = sum(len(entry.moments) * DIMS[entry.term] for entry in GROUP.terms if not entry.ticks)
    return slice(measured, None)


class Watch:
    """An observer that keeps what the actor saw."""

    def __init__(self):
        self.seen = []

    def __call__(self, reading, result, timer):
        if result.output is not None:
            self.seen.append(result.output.observation["obs"])


@pytest.mark.parametrize("kind", ["full", "vr3", "reach", "steer"])
def test_the_goal_of_training_is_that_of_the_clip_source_through_the_loop(kind, tmp_path):
    """The states of a training's robot, as a device would say them, through loop, tick, guard and controller."""
    env = build_environment(
        settings(
            start={"first_frame": 1.0}, goals={"kinds": {kind: 1.0}}, observations="goals",
            critic=["history", "reference_position"],
        ),
        ROBOT, build_reference(open_motion("side_kick", ROBOT), ROBOT), num_envs=1, seed=2, threads=1,
    )  # fmt: skip
    assert env.state.goal.tolist() == [bits_of(KINDS[kind])]
    readings, wanted, generator = [], [], torch.Generator().manual_seed(4)
    for _ in range(TICKS):
        now = env.simulator.state()
        readings.append(
            state(
                imu_quat_wxyz=now.root_quat_wxyz[0].numpy().astype(float),
                imu_ang_vel_b=now.root_ang_vel_b[0].numpy().astype(float),
                joint_pos_rad=now.joint_pos_rad[0].numpy().astype(float),
                joint_vel_rad_s=now.joint_vel_rad_s[0].numpy().astype(float),
            )
        )
        wanted.append(env.observations.groups(env.state.actor_history)["actor"][0].numpy())
        env.step(0.05 * torch.randn(1, 23, generator=generator))
    run = load_run(write_goal_actor(tmp_path / "goals.onnx"), "side_kick", ROBOT, SETTINGS.entry, kind)
    cell, watch, clock = Cell(ROBOT, SETTINGS, [run]), Watch(), SimulatedClock(3.0)
    plan = cell.start_tracking()
    backend = FakeBackend(readings, clock)
    cell.loop(backend, clock, plan=plan, observers=[watch], duration_s=(TICKS - 1) * PERIOD_S).run()
    assert cell.machine.fault is None and len(watch.seen) >= TICKS - 1
    goal = goal_columns()
    assert max(np.abs(values[goal]).max() for values in wanted) > 0.5
    for seen, values in zip(watch.seen, wanted):
        assert seen[goal] == pytest.approx(values[goal], abs=1e-6)
