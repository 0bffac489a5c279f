"""The recorded-rollout parity: what an actor is fed and what it makes of it, and that every change of a spec shows."""

from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from policy.actor import load_actor
from policy.controller import PolicyController
from policy.spec import ObservationGroup
from tests.policy.toys import GROUP, JOINTS, random_states, toy_robot, toy_spec, weights, write_actor

TICKS = 12


def rotate_inverse(quat, v):
    w, x, y, z = quat
    matrix = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return matrix.T @ v


def rollout_by_hand(states) -> tuple[np.ndarray, np.ndarray]:
    """(actions (T, 3), targets (T, 3)) of the toy actor, from its layout as a person would write it down."""
    spec = toy_spec()
    w1, b1, w2, b2 = (p.astype(np.float64) for p in weights())
    zero = np.zeros(3)
    actions, targets = [], []
    for tick, s in enumerate(states):
        before = states[tick - 1] if tick else None
        obs = np.concatenate(
            [
                s["joint_pos_rad"] - spec.default_pos_rad,
                before["joint_pos_rad"] - spec.default_pos_rad if before else zero,
                0.25 * s["base_ang_vel_b"],
                0.5 * (actions[tick - 3] if tick >= 3 else zero),
                0.5 * (actions[tick - 1] if tick >= 1 else zero),
                [s["phase"]],
                np.clip(0.05 * before["joint_vel_rad_s"], -2.0, 2.0) if before else zero,
                rotate_inverse(s["base_quat_wxyz"], np.array([0.0, 0.0, -1.0])),
            ]
        )
        actions.append(w2 @ np.tanh(w1 @ obs + b1) + b2)
        targets.append(spec.default_pos_rad + spec.action_scale * actions[-1])
    return np.array(actions), np.array(targets)


def play(tmp_path, spec, robot=None, states=None):
    robot = toy_robot() if robot is None else robot
    controller = PolicyController(load_actor(write_actor(tmp_path / "a.onnx", spec), robot), robot)
    return [controller.act(**s) for s in (random_states(TICKS) if states is None else states)]


def targets_of(outputs):
    return np.array([output.target_rad for output in outputs])


def test_a_rollout_matches_the_one_made_by_hand(tmp_path):
    outputs = play(tmp_path, toy_spec())
    actions, targets = rollout_by_hand(random_states(TICKS))
    np.testing.assert_allclose([output.action for output in outputs], actions, atol=1e-5)
    np.testing.assert_allclose(targets_of(outputs), targets, atol=1e-5)
    assert outputs[0].kp.tolist() == [100.0, 150.0, 40.0]
    assert outputs[0].kd.tolist() == [2.0, 4.0, 0.1]
    assert outputs[0].observation["obs"].dtype == np.float32


def test_joints_are_mapped_by_name(tmp_path):
    """The same world seen by a robot whose joint table has another order gives the same targets per joint."""
    names = ("ankle", "hip", "knee")
    order = [JOINTS.index(name) for name in names]
    states = random_states(TICKS)
    permuted = [
        s | {"joint_pos_rad": s["joint_pos_rad"][order], "joint_vel_rad_s": s["joint_vel_rad_s"][order]} for s in states
    ]
    outputs = play(tmp_path, toy_spec(), toy_robot(names), permuted)
    actions, targets = rollout_by_hand(states)
    np.testing.assert_allclose(targets_of(outputs), targets[:, order], atol=1e-5)
    np.testing.assert_allclose([output.action for output in outputs], actions[:, order], atol=1e-5)
    assert outputs[0].kp.tolist() == [40.0, 100.0, 150.0]


def changed_term(index, **changes):
    terms = list(GROUP.terms)
    terms[index] = replace(terms[index], **changes)
    return {"observations": (ObservationGroup("obs", tuple(terms)),)}


SWAPPED = [1, 0, 2]
MUTATIONS = {
    "two joints swapped": {"joint_names": ("knee", "hip", "ankle")},
    "two default positions swapped": {"default_pos_rad": toy_spec().default_pos_rad[SWAPPED]},
    "two action scales swapped": {"action_scale": toy_spec().action_scale[SWAPPED]},
    "another action scale": {"action_scale": toy_spec().action_scale * 1.0067},
    "a tight action clip": {"action_clip": 0.1},
    "another observation scale": changed_term(1, scale=0.2),
    "lags in the other order": changed_term(0, lags=(1, 0)),
    "another lag": changed_term(2, lags=(2, 1)),
    "another term of the same size": changed_term(4, term="dof_pos"),
    "another clip": changed_term(4, clip=0.3),
    "terms in another order": {"observations": (ObservationGroup("obs", (*GROUP.terms[1:], GROUP.terms[0])),)},
    "history that repeats": {"history_start": "repeat"},
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_every_change_of_a_spec_that_no_check_can_see_changes_the_rollout(tmp_path, name):
    right = targets_of(play(tmp_path, toy_spec()))
    changed = targets_of(play(tmp_path, toy_spec(**MUTATIONS[name])))
    assert np.abs(changed - right).max() > 1e-4


@pytest.mark.parametrize("index", range(len(GROUP.terms)))
def test_a_change_of_dimension_is_refused(tmp_path, index):
    with pytest.raises(InputError, match="graph input 'obs': wrong size"):
        play(tmp_path, toy_spec(**changed_term(index, lags=(0, 1, 2, 3))))


def test_reset_forgets_everything(tmp_path):
    robot = toy_robot()
    controller = PolicyController(load_actor(write_actor(tmp_path / "a.onnx"), robot), robot)
    states = random_states(TICKS)
    first = targets_of([controller.act(**s) for s in states])
    assert np.abs(targets_of([controller.act(**s) for s in states]) - first).max() > 1e-4
    controller.reset()
    assert targets_of([controller.act(**s) for s in states]).tolist() == first.tolist()


def filtered_by_hand(states) -> np.ndarray:
    """Directions of gravity (T, 3): turned by the gyroscope, then drawn to what is measured, at last by 1/25."""
    found = []
    for tick, s in enumerate(states):
        measured, (x, y, z) = rotate_inverse(s["base_quat_wxyz"], np.array([0.0, 0.0, -1.0])), s["base_ang_vel_b"]
        before = found[-1] if found else measured
        turned = before - 0.02 * np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ before
        mixed = turned + max(1.0 / (1 + tick), 1.0 / 25.0) * (measured - turned)
        found.append(mixed / np.linalg.norm(mixed))
    return np.array(found)


def test_filtered_gravity_is_that_of_all_states_since_the_last_reset(tmp_path):
    robot, states = toy_robot(), random_states(40)
    spec = toy_spec(**changed_term(5, term="filtered_gravity"))
    controller = PolicyController(load_actor(write_actor(tmp_path / "a.onnx", spec), robot), robot)
    for part in (states, states[7:20]):
        seen = np.array([controller.act(**s).observation["obs"][-3:] for s in part])
        np.testing.assert_allclose(seen, filtered_by_hand(part), atol=1e-6)
        controller.reset()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_state_that_is_not_finite_shows_in_the_action(tmp_path, bad):
    """An infinite speed would otherwise be clipped to an ordinary number before the graph."""
    robot = toy_robot()
    controller = PolicyController(load_actor(write_actor(tmp_path / "a.onnx"), robot), robot)
    state = random_states(1)[0]
    output = controller.act(**state | {"joint_vel_rad_s": np.array([0.0, bad, 0.0])})
    assert np.isnan(output.action).all() and np.isnan(output.target_rad).all()
    controller.reset()
    assert np.isfinite(controller.act(**state).action).all()


def test_extreme_states_give_finite_targets(tmp_path):
    states = random_states(6)
    for s, value in zip(states, (1e6, -1e6, 1e-310, 1e300, -1e38, 0.0), strict=True):
        s["joint_pos_rad"] = np.full(3, value)
        s["base_ang_vel_b"] = np.full(3, -value)
    outputs = play(tmp_path, toy_spec(), states=states)
    assert np.isfinite(targets_of(outputs)).all()
    assert all(np.abs(output.observation["obs"]).max() <= 100.0 for output in outputs)


def test_outputs_cannot_be_altered(tmp_path):
    output = play(tmp_path, toy_spec())[0]
    for values in (output.action, output.target_rad, output.kp, output.kd):
        with pytest.raises(ValueError):
            values[0] = 0.0


def test_another_robot_is_refused(tmp_path):
    actor = load_actor(write_actor(tmp_path / "a.onnx"), toy_robot())
    with pytest.raises(InputError, match="the joints of actor and robot differ, got ankle, toe"):
        PolicyController(actor, toy_robot(("hip", "knee", "toe")))
