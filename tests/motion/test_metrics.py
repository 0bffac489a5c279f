"""The metrics against numbers worked out by hand, and against one plain loop over the definitions."""

import math

import numpy as np
import pytest

from motion.metrics import (
    DEFINITIONS,
    METRIC_KEYS,
    TRACKING_KEYS,
    Track,
    contact_error,
    eg_mpbpe_mm,
    empbae_mm,
    empbpe_mm,
    empbve_mm,
    empjpe_mrad,
    empjve_mrad,
    episode_length_ratio,
    over_episodes,
    reference_track,
    tracking_metrics,
)
from motion.reference import build_reference

# Two bodies (root, hand), three steps. The reference rests.
REF_BODY = np.array([[[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]]] * 3)
BODY = np.array(
    [
        [[0.0, 0.0, 1.0], [0.5, 0.0, 1.0]],
        [[0.003, 0.004, 1.0], [0.5, 0.0, 1.0]],  # root off by 5 mm, hand exact
        [[0.0, 0.0, 1.0], [0.5, 0.0, 1.012]],  # root exact, hand off by 12 mm
    ]
)
REF_JOINT = np.zeros((3, 2))
JOINT = np.array([[0.0, 0.0], [0.3, 0.4], [0.3, 0.0]])


def test_global_position_error():
    np.testing.assert_allclose(eg_mpbpe_mm(BODY, REF_BODY), [0.0, 2.5, 6.0], atol=1e-12)


def test_root_relative_position_error():
    """Step 1: the root is exact by definition, the hand -5 mm against it."""
    np.testing.assert_allclose(empbpe_mm(BODY, REF_BODY), [0.0, 2.5, 6.0], atol=1e-12)
    moved = BODY + np.array([10.0, -4.0, 2.0])
    np.testing.assert_allclose(empbpe_mm(moved, REF_BODY), [0.0, 2.5, 6.0], atol=1e-9)
    np.testing.assert_allclose(eg_mpbpe_mm(REF_BODY + np.array([0.003, 0.0, 0.004]), REF_BODY), 5.0, atol=1e-12)


def test_joint_error_is_the_norm_of_all_joints():
    np.testing.assert_allclose(empjpe_mrad(JOINT, REF_JOINT), [0.0, 500.0, 300.0], atol=1e-12)


def test_joint_velocity_error_is_per_step():
    np.testing.assert_allclose(empjve_mrad(JOINT, REF_JOINT), [500.0, 400.0], atol=1e-12)


def test_body_velocity_error():
    """Root moves 5 mm and back; the hand 0, then 12 mm."""
    np.testing.assert_allclose(empbve_mm(BODY, REF_BODY), [2.5, (5.0 + 12.0) / 2], atol=1e-12)


def test_body_acceleration_error():
    """Second differences: root 2 x 5 mm, hand 12 mm."""
    np.testing.assert_allclose(empbae_mm(BODY, REF_BODY), [(10.0 + 12.0) / 2], atol=1e-12)


def test_a_moving_reference_counts_in_differences():
    drift = np.arange(3)[:, None, None] * np.array([0.001, 0.0, 0.0])
    np.testing.assert_allclose(empbve_mm(REF_BODY + drift, REF_BODY), 1.0, atol=1e-12)
    np.testing.assert_allclose(empbae_mm(REF_BODY + drift, REF_BODY), 0.0, atol=1e-12)
    np.testing.assert_allclose(empbve_mm(REF_BODY + drift, REF_BODY + drift), 0.0, atol=1e-12)


def test_contact_error():
    got = contact_error(np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0], [0.5, 1.0], [1.0, 1.0]]))
    np.testing.assert_allclose(got, [0.0, 0.25, 1.0])


def test_episode_means():
    contact, ref_contact = np.ones((3, 2)), np.array([[1.0, 1.0], [1.0, 0.5], [0.0, 0.5]])
    got = tracking_metrics(Track(BODY, JOINT, contact), Track(REF_BODY, REF_JOINT, ref_contact))
    assert tuple(got) == TRACKING_KEYS
    expected = [8.5 / 3, 8.5 / 3, 800.0 / 3, 450.0, (2.5 + 8.5) / 2, 11.0, (0.0 + 0.25 + 0.75) / 3]
    assert list(got.values()) == pytest.approx(expected)


def test_against_a_plain_loop():
    rng = np.random.default_rng(0)
    body, ref_body = rng.normal(size=(6, 27, 3)), rng.normal(size=(6, 27, 3))
    joint, ref_joint = rng.normal(size=(6, 23)), rng.normal(size=(6, 23))
    got = tracking_metrics(Track(body, joint), Track(ref_body, ref_joint))

    def mean(values):
        return 1000.0 * sum(values) / len(values)

    def rows(order, array):
        return [
            {0: array[t], 1: array[t] - array[t - 1], 2: array[t] - 2 * array[t - 1] + array[t - 2]}[order]
            for t in range(order, 6)
        ]

    def body_mean(order, a, b):
        pairs = zip(rows(order, a), rows(order, b), strict=True)
        return mean([math.dist(p, q) for x, y in pairs for p, q in zip(x, y, strict=True)])

    def joint_mean(order):
        return mean([math.dist(x, y) for x, y in zip(rows(order, joint), rows(order, ref_joint), strict=True)])

    assert got["eg_mpbpe_mm"] == pytest.approx(body_mean(0, body, ref_body))
    assert got["empbpe_mm"] == pytest.approx(body_mean(0, body - body[:, :1], ref_body - ref_body[:, :1]))
    assert got["empbve_mm"] == pytest.approx(body_mean(1, body, ref_body))
    assert got["empbae_mm"] == pytest.approx(body_mean(2, body, ref_body))
    assert got["empjpe_mrad"] == pytest.approx(joint_mean(0))
    assert got["empjve_mrad"] == pytest.approx(joint_mean(1))


def test_unknown_is_none():
    got = tracking_metrics(Track(BODY, JOINT, None), Track(REF_BODY, REF_JOINT, np.ones((3, 2))))
    assert got["contact_error"] is None and got["empjpe_mrad"] is not None
    one = tracking_metrics(Track(BODY[:1], JOINT[:1]), Track(REF_BODY, REF_JOINT))
    assert one["empjve_mrad"] is None and one["empbve_mm"] is None and one["empbae_mm"] is None
    assert one["eg_mpbpe_mm"] == 0.0
    none = tracking_metrics(Track(BODY[:0], JOINT[:0]), Track(REF_BODY, REF_JOINT))
    assert set(none.values()) == {None}


def test_only_the_steps_before_the_fall_count():
    full = tracking_metrics(Track(BODY[:2], JOINT[:2]), Track(REF_BODY[:2], REF_JOINT[:2]))
    assert tracking_metrics(Track(BODY[:2], JOINT[:2]), Track(REF_BODY, REF_JOINT)) == full


def test_shapes_must_agree():
    with pytest.raises(ValueError, match="shapes differ"):
        tracking_metrics(Track(BODY, JOINT), Track(REF_BODY[:2], REF_JOINT[:2]))
    with pytest.raises(ValueError, match="shapes differ"):
        empjpe_mrad(JOINT, REF_JOINT[:1])


def test_episode_length_ratio():
    assert episode_length_ratio(87, 348) == 0.25
    assert episode_length_ratio(348, 348) == 1.0


def test_over_episodes():
    episodes = [{"a": 1.0, "b": None, "c": 2.0}, {"a": 3.0, "b": None, "c": None}]
    assert over_episodes(episodes) == {
        "a": {"mean": 2.0, "std": 1.0},
        "b": None,
        "c": {"mean": 2.0, "std": 0.0},
    }
    assert over_episodes([]) == {}


def test_every_key_has_a_definition():
    assert set(DEFINITIONS) == set(METRIC_KEYS)


def test_the_state_after_tick_k_is_scored_against_row_k_plus_one(standing_clip, robot):
    angle = np.tile(robot.default_pos_rad, (31, 1))
    angle[:, 3] = np.arange(31) / 30.0
    reference = build_reference(standing_clip(joint_pos_rad=angle), robot)
    track = reference_track(reference, 10)
    assert len(track) == 10 and len(reference_track(reference)) == reference.num_ticks == 50
    np.testing.assert_allclose(track.joint_pos_rad[:, 3], 0.02 * np.arange(1, 11), atol=1e-12)
    np.testing.assert_array_equal(track.body_pos_w, reference.body_pos_w[1:11])
