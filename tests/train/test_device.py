"""Every tensor of the environment is made on the device that it was given."""

import pytest
import torch

from tests.train.worlds import CONSTANT, NOISE, settings, small_env


class OnTheCpu:
    """A simulator as it is on a CPU, whatever the default device is."""

    def __init__(self, simulator) -> None:
        self._simulator = simulator

    def __getattr__(self, name):
        with torch.device("cpu"):
            found = getattr(self._simulator, name)
        return self._on_cpu(found) if callable(found) else found

    @staticmethod
    def _on_cpu(method):
        def call(*arguments):
            with torch.device("cpu"):
                return method(*arguments)

        return call


CHANGES = {
    "start": {
        "first_frame": 0.2, "by_failure": 0.3, "joint_noise_rad": 0.02, "tilt_noise_rad": 0.02, "velocity_noise": 0.1,
    },
    "events": {"push": {"interval_s": [0.02, 0.1], "params": {"velocity_m_s": 0.3}}},
    "sensing": {"noise": NOISE},
    "penalty_step_max": 0.2,
    "observations": "window",
    "randomization_scale": CONSTANT,
}  # fmt: skip


TAUGHT = CHANGES | {
    "observations": "goals", "teacher": "tracker",
    "goals": {
        "kinds": {"bodies": 0.5, "random": 0.5}, "redraw_per_s": 5.0, "gap_per_s": 5.0, "gap_s": [0.02, 0.1],
    },
}  # fmt: skip


@pytest.mark.parametrize("changes", [CHANGES, TAUGHT], ids=["window", "taught"])
def test_an_environment_makes_no_tensor_on_the_default_device(monkeypatch, changes):
    """The default device here has no numbers: a tensor of it among those of the environment is an error."""
    build = "train.mdp.factory.MujocoCpuSimulator"
    from train.simulation.mujoco_cpu import MujocoCpuSimulator

    monkeypatch.setattr(build, lambda *a, **k: OnTheCpu(OnTheCpu._on_cpu(lambda: MujocoCpuSimulator(*a, **k))()))
    plain = small_env(seconds=0.3, **changes)
    with torch.device("meta"):
        env = small_env(seconds=0.3, **changes)
        for _ in range(25):
            action = torch.full((env.num_envs, env.num_actions), 0.1, device="cpu")
            result, expected = env.step(action), plain.step(action)
            env.finish_iteration()
        env.load_state_dict(env.state_dict())
    assert {tensor.device.type for tensor in env.state.tensors().values()} == {"cpu"}
    assert torch.equal(result.rewards, expected.rewards)
    assert all(torch.equal(values, expected.observations[group]) for group, values in result.observations.items())


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_an_environment_on_a_gpu_gives_the_same_numbers():
    from tests.train.worlds import g1, swaying_reference
    from train.mdp.factory import build_environment

    reference = swaying_reference(g1(), 0.3)
    envs = [
        build_environment(settings(**CHANGES), g1(), reference, num_envs=4, seed=3, threads=2, device=device)
        for device in ("cpu", "cuda")
    ]
    for _ in range(25):
        results = [env.step(torch.full((4, 23), 0.1, device=env.device)) for env in envs]
    torch.testing.assert_close(results[1].rewards.cpu(), results[0].rewards, atol=1e-3, rtol=1e-3)
