"""benchmarks/changed_training.py: each change, seen where it acts, and gone afterwards."""

import subprocess
import sys

import pytest
import torch

from tests.train.programs import BENCHMARKS, load
from tests.train.world_model.small import SMALL, WARM_UP, iterate, small
from tests.train.worlds import beginning_of

changed = load("changed_training")


@pytest.fixture(scope="module")
def trained():
    """Environment and learner of the small training after its first steps."""
    env, learner = small("world_model.processes=1")
    iterate(env, learner, env.reset(), 12)
    yield env, learner
    learner.close()


def steps(learner):
    """What the world model is fitted to: some steps of the ring, and the context of another robot for each."""
    ring = learner.ring
    times, robots = ring.sample(64, 1, None, torch.Generator().manual_seed(3))
    return ring.at(times[0], robots)


def context_of(packed):
    import train.world_model.imagination as imagination

    return imagination.context_of(packed, 23)


def seen(learner, packed, targets):
    """Inputs of the network, from one state with such context and targets."""
    from train.world_model.state import unpack

    first = steps(learner)
    motion = unpack(first.state)
    gravity_b = torch.tensor([0.0, 0.0, -1.0]).expand(64, 3)
    return learner.fitting.model.inputs(motion, gravity_b, targets, context_of(packed))


def test_the_context_is_untold_but_delays_and_gains_act(trained):
    _, learner = trained
    packed = steps(learner).context
    told = context_of(packed)
    with changed.no_context():
        untold = context_of(packed)
    assert told.features.abs().sum() > 0 and not untold.features.any()
    assert untold.kp_scale.equal(told.kp_scale) and untold.early.equal(told.early)
    assert untold.sensing.encoder_offset_rad.equal(told.sensing.encoder_offset_rad)
    assert context_of(packed).features.equal(told.features)


def test_of_the_last_targets_the_newest_two_are_seen_as_they_are(trained):
    _, learner = trained
    first = steps(learner)
    targets = tuple(first.target + 0.1 * k for k in range(3))
    usual = seen(learner, first.context, targets)
    with changed.previous_targets():
        plain = seen(learner, first.context, targets)
    q = first.state[:, 13:36]
    early, late = plain[:, 56:79], plain[:, 79:102]  # after height, gravity, two velocities, joints and their speeds
    assert torch.allclose(early, targets[1] - q, atol=1e-6) and torch.allclose(late, targets[0] - q, atol=1e-6)
    assert plain[:, :56].equal(usual[:, :56]) and not torch.allclose(plain[:, 56:102], usual[:, 56:102], atol=1e-3)


def test_plain_targets_are_the_references_joints_in_training_and_in_the_actor():
    from train.world_model import imagination, policy

    reference, feedforward = torch.full((2, 3), 0.5), torch.full((2, 3), 0.2)
    layout = type("Layout", (), {"base": [slice(0, 3), slice(3, 6)]})
    actor = policy.CarryingTargets(layout, 0.25)
    observation = torch.cat([reference, feedforward], dim=1)
    with changed.plain_targets():
        assert imagination.carrying_targets(reference, feedforward).tolist() == reference.tolist()
        assert torch.allclose(actor(observation), torch.full((2, 3), 2.0))
    assert torch.allclose(actor(observation), torch.full((2, 3), 2.8))


def test_a_cost_counts_by_the_smallest_running_mean_of_its_error(monkeypatch):
    from train.world_model import cost, policy_learning

    errors = iter([4.0, 4.0, 2.0, 8.0])
    monkeypatch.setattr(cost, "terms_of", lambda imagined, weights: {
        "points": torch.full((2, 3), next(errors)), "torque": torch.ones(2, 3)
    })  # fmt: skip
    with changed.adaptive_tolerance():
        terms = [policy_learning.terms_of(None, {}) for _ in range(4)]
    # Means: 4, 4, 4 - 0.01 · 2 = 3.98, 3.98 + 0.01 · 4.02 > 3.98.
    expected = [4.0, 4.0, 2.0 * 4.0 / 3.98, 8.0 * 4.0 / 3.98]
    assert [float(each["points"][0, 0]) for each in terms] == pytest.approx(expected)
    assert all(each["torque"].eq(1.0).all() for each in terms)


@pytest.mark.parametrize("change", changed.CHANGES)
def test_every_change_trains_and_leaves_an_actor(change, light, unjudged, tmp_path, monkeypatch):
    """Through the first round; what is known of blind spots is compared on fewer steps, in which every change acts."""
    monkeypatch.setattr("train.world_model.blindness.STEPS", 10)
    motion = f"motion={beginning_of('side_kick', 0.4, tmp_path)}"
    settings = [motion, *SMALL[1:], f"iterations={WARM_UP + 2}", f"run_dir={tmp_path / 'run'}", "evaluate_every=null"]
    assert changed.main([change, *settings]) == 0
    assert (tmp_path / "run" / "actor.onnx").is_file()


def test_an_unknown_change_is_exit_2_and_one_line(capsys):
    assert changed.main(["no_such"]) == 2
    assert capsys.readouterr().err == (
        "error: unknown change, got no_such, expected one of no_context, previous_targets, plain_targets, "
        "adaptive_tolerance\n"
    )


def test_as_a_program_it_names_every_change():
    command = [sys.executable, "-P", BENCHMARKS / "changed_training.py", "--help"]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 0, result.stderr
    assert all(f"\n{change} " in result.stdout for change in changed.CHANGES)
