"""Every tensor of the learner is made where the environment's are."""

import pytest
import torch

from robot.robot import load_robot
from tests.train.test_device import OnTheCpu
from tests.train.world_model.small import WARM_UP, iterate, small
from train.simulation.mujoco_cpu import MujocoCpuSimulator
from train.world_model import blindness

IN_TURN = ("world_model.processes=1", "train=goals", "world_model.round=1")
ITERATIONS = WARM_UP + 2  # then two rounds


def test_a_learner_makes_no_tensor_on_the_default_device(monkeypatch):
    """The default device here has no numbers: a tensor of it among those of the learner is an error."""
    env, learner = small(*IN_TURN)
    _, wanted = iterate(env, learner, env.reset(), ITERATIONS)
    monkeypatch.setattr(blindness, "STEPS", 10)
    made = "train.mdp.factory.MujocoCpuSimulator"
    monkeypatch.setattr(made, lambda *a, **k: OnTheCpu(OnTheCpu._on_cpu(lambda: MujocoCpuSimulator(*a, **k))()))
    with torch.device("meta"):
        env, learner = small(*IN_TURN, "device=cpu")
        _, rows = iterate(env, learner, env.reset(), ITERATIONS)
        learner.load_state_dict(learner.state_dict())
        assert learner.blind_spots(load_robot(), env.reset())
    assert rows == wanted and "imagined/cost" in rows[-1]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_learner_on_a_gpu_learns_what_one_on_a_cpu_does():
    rows = []
    for device in ("cpu", "cuda"):
        env, learner = small(*IN_TURN, f"device={device}")
        rows.append(iterate(env, learner, env.reset(), ITERATIONS)[1][-1])
    for name in ("imagined/cost", "model/window_loss"):
        assert rows[1][name] == pytest.approx(rows[0][name], rel=0.02)
