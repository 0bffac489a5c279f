from dataclasses import fields, replace

import numpy as np
import pytest

from core.errors import InputError
from policy.action import decode_action
from policy.goals import PARTS, POINTS
from policy.history import ObservationHistory
from policy.layouts import pbhc_actor_group
from policy.observation import (
    check_terms,
    entry_size,
    num_lags,
    observation_layout,
    sample_clip,
    sample_terms,
    sample_width,
    term_dims,
    term_order,
    window_ticks,
)
from policy.reference import ReferenceWindow
from policy.spec import ObservationGroup, ObservationTerm
from policy.terms import TERMS, ObservationInput, register
from tests.policy.toys import GROUP, SIZE

TICKS = (1, 4, 6)
NAMED = {"": "", "given": "steer", "point": "head", "body": "torso"}


def random_quat(rng, *shape) -> np.ndarray:
    quat = rng.normal(size=(*shape, 4))
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def random_window(rng, batch, joints) -> ReferenceWindow:
    shape = (*batch, len(TICKS))
    return ReferenceWindow(
        ticks=TICKS,
        joint_pos_rad=rng.normal(size=(*shape, joints)),
        joint_vel_rad_s=rng.normal(size=(*shape, joints)),
        root_height_m=rng.normal(size=shape),
        root_quat_wxyz=random_quat(rng, *shape),
        root_lin_vel_w=rng.normal(size=(*shape, 3)),
        root_ang_vel_w=rng.normal(size=(*shape, 3)),
        feedforward_rad=rng.normal(size=(*shape, joints)),
        bodies_quat_wxyz={"torso": random_quat(rng, *shape)},
        points_m=rng.normal(size=(*shape, len(POINTS), 3)),
        points_quat_wxyz=random_quat(rng, *shape, len(POINTS)),
        steer=rng.normal(size=(*shape, 4)),
        visible=rng.integers(2, size=(*batch, len(PARTS))).astype(float),
    )


def random_input(rng, batch=(), joints=23) -> ObservationInput:
    return ObservationInput(
        base_quat_wxyz=random_quat(rng, *batch),
        base_ang_vel_b=rng.normal(size=(*batch, 3)),
        joint_pos_rad=rng.normal(size=(*batch, joints)),
        joint_vel_rad_s=rng.normal(size=(*batch, joints)),
        last_action=rng.normal(size=(*batch, joints)),
        phase=rng.uniform(size=(*batch, 1)),
        default_pos_rad=rng.normal(size=joints),
        filtered_gravity_b=rng.normal(size=(*batch, 3)),
        bodies_quat_wxyz={"torso": random_quat(rng, *batch)},
        reference=random_window(rng, batch, joints),
        given={"steer": rng.normal(size=(*batch, 4))},
    )


def as_torch(torch, value):
    """The same input with tensors for arrays."""
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value)
    if isinstance(value, dict):
        return {name: as_torch(torch, part) for name, part in value.items()}
    if hasattr(value, "__dataclass_fields__"):
        return type(value)(**{f.name: as_torch(torch, getattr(value, f.name)) for f in fields(value) if f.init})
    return value


def entry_of(term: str) -> ObservationTerm:
    """A use of a term with all that it needs."""
    return ObservationTerm(term, ticks=(1, 6) if TERMS[term].windowed else (), of=NAMED[TERMS[term].of])


@pytest.mark.parametrize("term", sorted(TERMS))
@pytest.mark.parametrize("batch", [(), (7,), (2, 5)])
def test_numpy_and_torch_agree_on_every_term(term, batch):
    torch = pytest.importorskip("torch")
    s = random_input(np.random.default_rng(5), batch)
    entry = entry_of(term)
    expected = TERMS[term].sample(entry, s)
    got = TERMS[term].sample(entry, as_torch(torch, s))
    assert expected.shape == (*batch, entry_size(entry, term_dims(23, {"steer": 4})))
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
        filtered_gravity_b=np.array([0.6, 0.0, -0.8]),
    )
    looks_elsewhere = {name for name, term in TERMS.items() if term.windowed or term.of == "given"}
    expected = {
        "base_ang_vel": [1.0, 2.0, 3.0],
        "projected_gravity": [1.0, 0.0, 0.0],
        "filtered_gravity": [0.6, 0.0, -0.8],
        "dof_pos": [0.375, -0.25],
        "dof_vel": [-1.0, 4.0],
        "actions": [7.0, 8.0],
        "ref_motion_phase": [0.75],
    }
    assert set(expected) == set(TERMS) - looks_elsewhere
    for name, values in expected.items():
        np.testing.assert_allclose(TERMS[name].function(s), values, atol=1e-15)


def test_terms_that_look_ahead_mean_what_they_say():
    """The base looks along +y; the reference, two ticks ahead, along -x and pitched forwards by a quarter turn."""
    half = np.sqrt(0.5)
    window = ReferenceWindow(
        ticks=(1, 2),
        joint_pos_rad=np.array([[9.0, 9.0], [0.5, 0.25]]),
        joint_vel_rad_s=np.array([[9.0, 9.0], [-1.0, 4.0]]),
        root_height_m=np.array([9.0, 0.7]),
        # Turn by pi about z, then by pi/2 about the body's y: (0, 0, 0, 1) * (half, 0, half, 0).
        root_quat_wxyz=np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -half, 0.0, half]]),
        root_lin_vel_w=np.array([[9.0, 9.0, 9.0], [-2.0, 0.0, 0.5]]),
        root_ang_vel_w=np.array([[9.0, 9.0, 9.0], [0.0, -3.0, 1.0]]),
        feedforward_rad=np.array([[9.0, 9.0], [0.0625, -0.5]]),
        bodies_quat_wxyz={"torso": np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -half, 0.0, half]])},
        points_m=np.array([[[9.0] * 3] * 5, [[9.0] * 3, [9.0] * 3, [1.0, 0.0, 0.5], [9.0] * 3, [9.0] * 3]]),
        points_quat_wxyz=np.tile([1.0, 0.0, 0.0, 0.0], (2, 5, 1)),
        steer=np.array([[9.0] * 4, [1.0, 0.5, 0.25, np.pi]]),
        visible=np.arange(15) % 2.0,
    )
    s = replace(
        random_input(np.random.default_rng(0), joints=2),
        base_quat_wxyz=np.array([half, 0.0, 0.0, half]),
        joint_pos_rad=np.array([0.75, -1.0]),
        default_pos_rad=np.array([0.125, 0.5]),
        bodies_quat_wxyz={"torso": np.array([half, 0.0, 0.0, half])},
        reference=window,
    )
    expected = {
        "reference_joint_pos": [0.375, -0.25],
        "reference_joint_angle": [0.5, 0.25],
        "reference_joint_vel": [-1.0, 4.0],
        "reference_joint_error": [-0.25, 1.25],
        "reference_feedforward": [0.0625, -0.5],
        "reference_heading": [1.0, 0.0],  # from +y to -x, a quarter turn to the left
        "reference_root_height": [0.7],
        "reference_gravity": [1.0, 0.0, 0.0],  # pitched forwards: down is where the body looks
        # Its x axis points down, (0, 0, -1) in the world; its y axis is the world's -y, the base's -x.
        "reference_orientation": [0.0, 0.0, -1.0, -1.0, 0.0, 0.0],
        "reference_body_turn": [0.0, -1.0, 0.0, 0.0, -1.0, 0.0],  # the same two axes, row by row
        "reference_ang_vel": [0.0, 3.0, 1.0],
        "reference_lin_vel": [2.0, 0.0, 0.5],
        "goal_point": [0.0, -1.0, 0.5],  # of the head: the world's +x is on the right of who looks along +y
        "goal_turn": [0.0, -1.0, 0.0, 1.0, 0.0, 0.0],
        "goal_steer": [1.0, 0.5, 0.25, 1.0, 0.0],
        "goal_visible": [0.0, 1.0] * 7 + [0.0],
    }
    assert set(expected) == {name for name, term in TERMS.items() if term.windowed}
    gimbal = {"reference_ang_vel", "reference_lin_vel", "reference_heading"}  # looking straight down has no heading
    for name in expected.keys() - gimbal:
        use = ObservationTerm(name, ticks=(2,), of=NAMED[TERMS[name].of])
        np.testing.assert_allclose(TERMS[name].sample(use, s), expected[name], atol=1e-15)
    upright = replace(window, root_quat_wxyz=np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]))
    for name in gimbal:
        values = TERMS[name].function(replace(s, reference=upright), (2,))
        np.testing.assert_allclose(values, expected[name], atol=1e-15)


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        (ObservationTerm("dof_pos", ticks=(1,)), "dof_pos: ticks: do not fit the term, got [1], expected none"),
        (ObservationTerm("reference_gravity"), "reference_gravity: ticks: do not fit the term, got [], expected one"),
        (ObservationTerm("command"), "command: of: does not fit the term, got '', expected the name of a command"),
        (ObservationTerm("dof_pos", of="steer"), "dof_pos: of: does not fit the term, got 'steer', expected nothing"),
    ],
)
def test_parameters_that_do_not_fit_the_term_are_refused(entry, text):
    with pytest.raises(InputError) as caught:
        check_terms(ObservationGroup("obs", (entry,)))
    assert str(caught.value).startswith(f"observation group 'obs': {text}")


def test_a_term_that_looks_ahead_without_a_reference_says_what_to_do():
    s = replace(random_input(np.random.default_rng(0)), reference=None)
    with pytest.raises(InputError, match="give --motion"):
        sample_terms((entry_of("reference_gravity"),), s)


def test_the_windows_size_counts_in_the_layout():
    group = ObservationGroup(
        "obs", (ObservationTerm("reference_gravity", (0, 1), ticks=(1, 4)), ObservationTerm("dof_vel"))
    )
    dims = term_dims(2)
    history, rng = ObservationHistory(group, dims), np.random.default_rng(2)
    first, second = (random_input(rng, joints=2) for _ in range(2))
    history.push(sample_terms(term_order(group), first))
    got = history.push(sample_terms(term_order(group), second))
    expected = [TERMS["reference_gravity"].function(s, (1, 4)) for s in (second, first)]
    np.testing.assert_allclose(got, np.concatenate([*expected, second.joint_vel_rad_s]), rtol=1e-6)
    assert window_ticks([group]) == (1, 4)


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
    layout = observation_layout(GROUP, dims)
    bound = torch.from_numpy(sample_clip(terms, dims))
    histories = [ObservationHistory(GROUP, dims) for _ in range(batch)]
    default = rng.normal(size=3)
    for _ in range(6):
        s = replace(
            random_input(rng, (batch,), 3), default_pos_rad=default, reference=None, given={}, bodies_quat_wxyz={}
        )
        sample = sample_terms(terms, as_torch(torch, s)).clip(-bound, bound)
        block = torch.cat([sample[:, None], block[:, :-1]], 1)
        got = layout.of(block.reshape(batch, -1)[:, torch.from_numpy(layout.index)])
        assert got.shape == (batch, SIZE)
        for env in range(batch):
            shared = ("default_pos_rad", "reference", "given", "bodies_quat_wxyz")
            one = ObservationInput(**{k: v if k in shared else v[env] for k, v in vars(s).items() if k != "shared"})
            expected = histories[env].push(sample_terms(terms, one))
            np.testing.assert_allclose(got[env].numpy(), expected, rtol=1e-6, atol=1e-7)


def test_a_mean_over_lags_stands_where_its_entry_does():
    terms = (
        ObservationTerm("base_ang_vel", scale=0.5), ObservationTerm("dof_pos", (1, 2, 3), mean=True),
        ObservationTerm("dof_pos", (2, 0)), ObservationTerm("base_ang_vel", (1, 3), scale=0.5, mean=True),
    )  # fmt: skip
    group = ObservationGroup("obs", terms)
    history = ObservationHistory(group, term_dims(2))
    assert observation_layout(group, term_dims(2)).size == 3 + 2 + 4 + 3 and num_lags(group) == 4
    samples = np.arange(25.0).reshape(5, 5)  # per tick: 3 of the gyro, 2 joints
    for sample in samples:
        observation = history.push(sample)
    newest_first = samples[::-1]
    gyro, joints = newest_first[:, :3], newest_first[:, 3:]
    expected = [gyro[0], (joints[1] + joints[2] + joints[3]) / 3, joints[2], joints[0], (gyro[1] + gyro[3]) / 2]
    np.testing.assert_array_equal(observation, np.concatenate(expected))


def test_a_mean_before_the_first_ticks_counts_zeros():
    group = ObservationGroup("obs", (ObservationTerm("projected_gravity", (0, 1, 2, 3), mean=True),))
    observation = ObservationHistory(group, term_dims(2)).push(np.array([0.0, 0.4, -1.0]))
    np.testing.assert_allclose(observation, [0.0, 0.1, -0.25])


@pytest.mark.parametrize("mean", ["yes", True])
def test_a_mean_that_is_none_is_refused(mean):
    with pytest.raises(InputError, match="unusable mean"):
        ObservationTerm("dof_pos", (0,), mean=mean)


def test_action_decoding_is_the_same_in_numpy_and_torch():
    action, default, scale = np.array([1.0, -250.0, 1e6]), np.array([0.1, 0.2, 0.3]), np.array([0.25, 0.5, 0.01])
    expected = [0.35, 0.2 - 50.0, 0.3 + 1.0]
    np.testing.assert_allclose(decode_action(action, default, scale, 100.0), expected, rtol=1e-12)
    torch = pytest.importorskip("torch")
    got = decode_action(*(torch.from_numpy(v) for v in (action, default, scale)), 100.0)
    np.testing.assert_allclose(got.numpy(), expected, rtol=1e-12)


def test_an_unknown_term_is_refused_with_the_known_ones():
    group = ObservationGroup("obs", (ObservationTerm("dof_pos"), ObservationTerm("dof_poss")))
    known = ", ".join(sorted(TERMS))
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
