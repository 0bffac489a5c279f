"""What happens to robots from time to time, and that it is told of."""

import torch

from tests.train.test_environment import small_env


def test_it_says_whom_a_push_has_moved():
    """A first push of metres a second changes a root's speed at once; a step by itself does not by half as much."""
    env = small_env(seconds=0.4, events={"push": {"interval_s": [0.1, 0.2], "params": {"velocity_m_s": 9.0}}})
    untouched = torch.ones(4, dtype=torch.bool)
    pushed = 0
    for _ in range(12):
        before = env.state.physics.root_lin_vel_w[:, :2].clone()
        result = env.step(torch.zeros(4, 23))
        untouched &= ~(result.terminated | result.timed_out)
        jumped = (env.state.physics.root_lin_vel_w[:, :2] - before).norm(dim=1) > 0.5
        assert torch.equal(jumped[untouched], env.disturbed[untouched])
        pushed += int(env.disturbed[untouched].sum())
        untouched &= ~env.disturbed
    assert pushed > 0
