from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from policy.action import decode_action
from policy.history import ObservationHistory
from policy.layouts import pbhc_actor_group
from policy.observation import (
    check_terms,
    gather_index,
    num_lags,
    sample_clip,
    sample_terms,
    sample_width,
    term_dims,
    term_order,
)
from policy.spec import ObservationGroup, ObservationTerm
from policy.terms import TERMS, ObservationInput, register
from tests.policy.toys import GROUP, SIZE


def random_input(rng, batch=(), joints=23) -> ObservationInput:
    quat = rng.normal(size=(*batch, 4))
    return ObservationInput(
        base_quat_wxyz=quat / np.linalg.norm(quat, axis=-1, keepdims=True),
        base_ang_vel_b=rng.normal(size=(*batch, 3)),
        joint_pos_rad=rng.normal(size=(*batch, joints)),
        joint_vel_rad_s=rng.normal(size=(*batch, joints)),
        last_action=rng.normal(size=(*batch, joints)),
        phase=rng.uniform(size=(*batch, 1)),
        default_pos_rad=rng.normal(size=joints),
    )


def as_torch(torch, s: ObservationInput) -> ObservationInput:
    return ObservationInput(**{name: torch.from_numpy(value) for name, value in vars(s).items()})


@pytest.mark.parametrize("term", sorted(TERMS))
@pytest.mark.parametrize("batch", [(), (7,), (2, 5)])
def test_numpy_and_torch_agree_on_every_term(term, batch):
    torch = pytest.importorskip("torch")
    s = random_input(np.random.default_rng(5), batch)
    expected = TERMS[term].function(s)
    got = TERMS[term].function(as_torch(torch, s))
    assert expected.shape == (*batch, term_dims(23)[term])
    assert got.dtype == torch.float64
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-6, atol=1e-12)


def test_terms_mean_what_they_say():
    """A quarter turn about y: gravity lies along the body's +x."""
    s = ObservationInput(
        base_quat_wxyz=np.array([np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]),
        base_ang_vel_b=np.array([1.0, 2.0, 3.0]),
        joint_pos_rad=np.array([0.5, 0.25]),
        joint_vel_rad_s=np.array([-1.0, 4.0]),
        last_action=np.array([7.0, 8.0]),
        phase=np.array([0.75]),
        default_pos_rad=np.array([0.125, 0.5]),
    )
    expected = {
        "base_ang_vel": [1.0, 2.0, 3.0],
        "projected_gravity": [1.0, 0.0, 0.0],
        "dof_pos": [0.375, -0.25],
        "dof_vel": [-1.0, 4.0],
        "actions": [7.0, 8.0],
        "ref_motion_phase": [0.75],
    }
    assert set(expected) == set(TERMS)
    for name, values in expected.items():
        np.testing.assert_allclose(TERMS[name].function(s), values, atol=1e-15)


def pbhc_by_hand(samples: list[dict[str, np.ndarray]]) -> np.ndarray:
    """The released layout, written out from its description; ``samples`` newest first, five of them."""
    now, past = samples[0], samples[1:5]
    parts = [now["actions"], now["base_ang_vel"], now["dof_pos"], now["dof_vel"]]
    for term in ("actions", "base_ang_vel", "dof_pos", "dof_vel", "projected_gravity", "ref_motion_phase"):
        parts += [sample[term] for sample in past]
    return np.concatenate([*parts, now["projected_gravity"], now["ref_motion_phase"]])


def test_the_pbhc_layout_has_380_numbers_in_their_order():
    group = pbhc_actor_group()
    dims = term_dims(23)
    terms = term_order(group)
    scales = {"base_ang_vel": 0.25, "projected_gravity": 1, "dof_pos": 1, "dof_vel": 0.05, "actions": 1}
    scales["ref_motion_phase"] = 1
    assert num_lags(group) == 5
    rng = np.random.default_rng(1)
    inputs = [random_input(rng) for _ in range(9)]
    history = ObservationHistory(group, dims)
    zero = {name: np.zeros(dims[name]) for name in scales}
    for tick, s in enumerate(inputs):
        got = history.push(sample_terms(terms, s))
        past = [
            {name: TERMS[name].function(inputs[at]) * scale for name, scale in scales.items()} if at >= 0 else zero
            for at in range(tick, tick - 5, -1)
        ]
        assert got.shape == (380,)
        np.testing.assert_allclose(got, pbhc_by_hand(past), rtol=1e-6, atol=1e-7)


def test_first_ticks_by_hand():
    """Two joints, two terms; 'dof_vel' clipped at 2, lags in an unusual order."""
    group = ObservationGroup("g", (ObservationTerm("dof_vel", (2, 0), 0.5, 2.0), ObservationTerm("dof_pos", (1,))))
    history = ObservationHistory(group, term_dims(2))
    samples = [[1.0, -1.0, 10.0, 11.0], [5.0, 1.5, 20.0, 21.0], [-9.0, 0.5, 30.0, 31.0]]
    assert history.push(np.array(samples[0])).tolist() == [0, 0, 1.0, -1.0, 0, 0]
    assert history.push(np.array(samples[1])).tolist() == [0, 0, 2.0, 1.5, 10.0, 11.0]
    assert history.push(np.array(samples[2])).tolist() == [1.0, -1.0, -2.0, 0.5, 20.0, 21.0]
    history.reset()
    assert history.push(np.array(samples[2])).tolist() == [0, 0, -2.0, 0.5, 0, 0]


def test_history_can_start_by_repeating_the_first_sample():
    group = ObservationGroup("g", (ObservationTerm("dof_pos", (0, 1, 2)),))
    history = ObservationHistory(group, term_dims(1), "repeat")
    assert history.push(np.array([3.0])).tolist() == [3.0, 3.0, 3.0]
    assert history.push(np.array([4.0])).tolist() == [4.0, 3.0, 3.0]
    history.reset()
    assert history.push(np.array([5.0])).tolist() == [5.0, 5.0, 5.0]
    with pytest.raises(InputError, match="unknown history start, got 'ones', expected zeros or repeat"):
        ObservationHistory(group, term_dims(1), "ones")


def test_the_same_term_may_appear_at_two_scales():
    group = ObservationGroup("g", (ObservationTerm("dof_pos", (0,), 1.0), ObservationTerm("dof_pos", (0, 1), 10.0)))
    history = ObservationHistory(group, term_dims(1))
    assert sample_width(term_order(group), term_dims(1)) == 2
    history.push(np.array([1.0, 10.0]))
    assert history.push(np.array([2.0, 20.0])).tolist() == [2.0, 20.0, 10.0]


def test_batched_torch_observation_equals_the_robots():
    """What training does (batch of histories in torch, clip, gather) against the robot's class, from the first tick."""
    torch = pytest.importorskip("torch")
    dims = term_dims(3)
    terms = term_order(GROUP)
    rng = np.random.default_rng(8)
    batch, lags, width = 4, num_lags(GROUP), sample_width(terms, dims)
    block = torch.zeros(batch, lags, width, dtype=torch.float64)
    index = torch.from_numpy(gather_index(GROUP, dims))
    bound = torch.from_numpy(sample_clip(terms, dims))
    histories = [ObservationHistory(GROUP, dims) for _ in range(batch)]
    default = rng.normal(size=3)
    for _ in range(6):
        s = replace(random_input(rng, (batch,), 3), default_pos_rad=default)
        sample = sample_terms(terms, as_torch(torch, s)).clip(-bound, bound)
        block = torch.cat([sample[:, None], block[:, :-1]], 1)
        got = block.reshape(batch, -1)[:, index]
        assert got.shape == (batch, SIZE)
        for env in range(batch):
            one = ObservationInput(**{k: v if k == "default_pos_rad" else v[env] for k, v in vars(s).items()})
            expected = histories[env].push(sample_terms(terms, one))
            np.testing.assert_allclose(got[env].numpy(), expected, rtol=1e-6, atol=1e-7)


def test_action_decoding_is_the_same_in_numpy_and_torch():
    action, default, scale = np.array([1.0, -250.0, 1e6]), np.array([0.1, 0.2, 0.3]), np.array([0.25, 0.5, 0.01])
    expected = [0.35, 0.2 - 50.0, 0.3 + 1.0]
    np.testing.assert_allclose(decode_action(action, default, scale, 100.0), expected, rtol=1e-12)
    torch = pytest.importorskip("torch")
    got = decode_action(*(torch.from_numpy(v) for v in (action, default, scale)), 100.0)
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-12)


def test_an_unknown_term_is_refused_with_the_known_ones():
    group = ObservationGroup("obs", (ObservationTerm("dof_pos"), ObservationTerm("dof_poss")))
    known = "actions, base_ang_vel, dof_pos, dof_vel, projected_gravity, ref_motion_phase"
    text = f"observation group 'obs': unknown observation term, got dof_poss, expected one of {known}"
    for call in (check_terms, term_order):
        with pytest.raises(InputError) as caught:
            call(group)
        assert str(caught.value) == text


def test_a_term_is_registered_once():
    def dof_pos(s):
        return s.phase

    with pytest.raises(ValueError, match="'dof_pos' is registered twice"):
        register(constant=1)(dof_pos)
