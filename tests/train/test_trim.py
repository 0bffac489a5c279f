"""Trimming: the whole step against least squares by another way; targets that were set wrong on purpose."""

import numpy as np
import pytest
import torch

from tests.train.worlds import g1, settings, swaying_reference
from train.phase_basis import num_knots
from train.priors import trim as module
from train.priors.module import BaseActionSettings, build_base_action
from train.priors.trim import Trim, whole_step

SECONDS = 0.8
SHOULDER = "left_shoulder_pitch_joint"


def test_the_whole_step_is_least_squares_with_a_price(monkeypatch):
    """A plant known exactly, two bodies beside the root; rows that stand for the price, appended."""
    monkeypatch.setattr(module, "RIDGE", 1e-12)
    monkeypatch.setattr(module, "MEMORY_KNOTS", 1)
    rng = np.random.default_rng(0)
    knots, joints, phases = 3, 2, np.array([0.1, 0.4, 0.6, 0.9])
    answer = 0.05 * rng.normal(size=(4, 9, knots * joints))
    answer[:2, :, 4:] = 0.0  # the last knot weighs nothing before half of the clip,
    answer[2:, :, :2] = 0.0  # and of the first one nothing is left after it
    bias = 0.02 * rng.normal(size=(4, 9))
    probes = 0.1 * rng.normal(size=(40, knots, joints))
    errors = (bias + np.einsum("tep,sp->ste", answer, probes.reshape(40, -1))).reshape(40, 4, 3, 3)

    def seen(vectors):
        """What the squares are of, of (..., 3, 3) vectors: bodies relative to the root, and the root."""
        root = vectors[..., :1, :]
        return np.concatenate([vectors[..., 1:, :] - root, module.ROOT_WEIGHT * root], axis=-2)

    linear = seen(np.moveaxis(answer, 1, 2).reshape(4, knots * joints, 3, 3)).reshape(4, knots * joints, -1)
    wanted = seen((bias + probes.reshape(40, -1).mean(0) @ np.moveaxis(answer, 1, 2)).reshape(4, 3, 3)).reshape(-1)
    rows = np.vstack([np.moveaxis(linear, 1, 2).reshape(-1, 6) / 2.0, np.sqrt(module.PRICE_M2) * np.eye(6)])
    expected = np.linalg.lstsq(rows, np.concatenate([-wanted / 2.0, np.zeros(6)]), rcond=None)[0]
    got = whole_step(torch.tensor(probes), torch.tensor(errors), torch.tensor(phases))
    assert got.shape == (knots, joints) and got.numpy().ravel() == pytest.approx(expected, rel=1e-4)


def trimmer(num_envs: int = 96):
    """A trimmer and its base action, which tracks a swaying shoulder without feedback."""
    robot = g1()
    reference = swaying_reference(robot, SECONDS)
    base = build_base_action(BaseActionSettings(kind="feedforward"), robot, reference, 0.25)
    assert base is not None
    return base, Trim(base, settings(), robot, reference, num_envs=num_envs, seed=1, threads=2)


def test_targets_that_were_set_wrong_come_back():
    """0.1 rad off at one shoulder: half of it goes in a step, as the largest share is half, and little else moves."""
    base, trim = trimmer()
    right = base.targets.clone()
    shoulder = g1().joint_names.index(SHOULDER)
    wrong = torch.zeros(num_knots(SECONDS), g1().num_joints)
    wrong[:, shoulder] = 0.4
    base.move_targets(wrong)
    assert (base.targets - right)[:, shoulder].tolist() == pytest.approx([0.4] * len(right), abs=1e-6)
    figures = trim.trim(base)
    left = (base.targets - right)[10:-10]  # the ends hardly count: before and after the knots there is no error
    assert figures["share"] == 0.5
    assert 0.15 < float(left[:, shoulder].mean()) < 0.28
    assert figures["empbpe_mm"] < 0.75 * figures["empbpe_mm_before"]
    again = trim.trim(base)
    assert again["empbpe_mm_before"] == pytest.approx(figures["empbpe_mm"], rel=0.2)  # other robots, other starts


def test_same_targets_same_trim():
    moved = []
    for _ in range(2):
        base, trim = trimmer(num_envs=24)
        figures = trim.trim(base)
        moved.append((base.targets, figures))
    assert torch.equal(moved[0][0], moved[1][0]) and moved[0][1] == moved[1][1]


def test_who_collapses_is_left_alone():
    base, trim = trimmer(num_envs=24)
    for side in ("left", "right"):
        base.targets[:, g1().joint_names.index(f"{side}_knee_joint")] += 8.0
        base.targets[:, g1().joint_names.index(f"{side}_hip_pitch_joint")] += 4.0
    before = base.targets.clone()
    assert trim.trim(base) == {"share": 0.0}
    assert torch.equal(base.targets, before)
