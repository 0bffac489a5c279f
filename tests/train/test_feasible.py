"""The motion that the robot can make: MuJoCo itself plays the targets that were found."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from motion.feet import ground_lift_m
from motion.inverse_dynamics import generalized_motion
from motion.library import open_motion
from motion.reference import Reference, build_reference
from robot.robot import Robot
from tests.train.worlds import g1, swaying_clip
from train.priors.feasible import NO_HELP_N, Nominal, feasible_motion
from train.priors.feedforward import feedforward_targets
from train.priors.module import PriorSettings, build_prior, linearization_model
from world.model import compile_model

LEAN_M = 0.10  # the root glides this far forward over feet that stay: nobody can stand that way with straight legs


def leaning_reference(robot: Robot) -> Reference:
    """Half a second in which the whole robot glides forward through its own feet, 20 mm above the ground."""
    clip = swaying_clip(robot, 0.5)
    root = clip.root_pos_w.copy()
    root[:, 0] += LEAN_M * (1.0 - np.cos(np.linspace(0.0, np.pi, len(root)))) / 2.0
    root[:, 2] += 0.02
    return build_reference(replace(clip, root_pos_w=root), robot)


@pytest.fixture(scope="module")
def found():
    robot = g1()
    reference = leaning_reference(robot)
    wanted = Nominal(reference, feedforward_targets(linearization_model(robot), robot, reference))
    lines: list[str] = []
    nominal = feasible_motion(robot, wanted, ground_lift_m(robot, reference), threads=2, progress=lines.append)
    return robot, reference, wanted, nominal, lines


def played(robot: Robot, nominal: Nominal) -> np.ndarray:
    """qpos (K+1, 7+J) of MuJoCo with position actuators, from the first state, without any feedback."""
    model = compile_model(robot, timestep_s=0.005, actuation="pd_position", strip_visuals=True)
    data = mujoco.MjData(model)
    qpos, qvel, _ = generalized_motion(nominal.reference)
    data.qpos[:], data.qvel[:] = qpos[0], qvel[0]
    states = [data.qpos.copy()]
    for targets in nominal.targets_rad[:-1]:
        data.ctrl[:] = targets
        mujoco.mj_step(model, data, 4)
        states.append(data.qpos.copy())
    return np.array(states)


def test_mujoco_makes_the_motion_from_its_targets_alone(found):
    robot, _, wanted, nominal, _ = found
    qpos, _, _ = generalized_motion(nominal.reference)
    away = np.abs(played(robot, nominal) - qpos)
    assert away[:, :3].max() < 5e-3 and away[:, 3:].max() < 2e-2
    # The reference itself, played the same way, is left far behind.
    given, _, _ = generalized_motion(wanted.reference)
    assert np.abs(played(robot, wanted) - given)[:, :3].max() > 0.02


def test_it_stays_near_what_was_wanted(found):
    _, reference, _, nominal, lines = found
    away = nominal.reference.root_pos_w - reference.root_pos_w
    assert np.linalg.norm(away[:, :2], axis=1).mean() < LEAN_M / 2
    assert away[-1, 2] == pytest.approx(-0.02, abs=0.02)  # on the ground, not above it
    assert np.abs(nominal.reference.joint_pos_rad - reference.joint_pos_rad).mean() < 0.1
    assert float(lines[-1].split()[-2]) <= NO_HELP_N < float(lines[0].split()[-2])  # in the worst half second


def test_it_survives_a_file(found, tmp_path):
    _, reference, _, nominal, _ = found
    nominal.save(tmp_path / "motion.npz")
    again = Nominal.load(tmp_path / "motion.npz", reference)
    assert again.targets_rad == pytest.approx(nominal.targets_rad, abs=0)
    for name in ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "root_lin_vel_w", "joint_vel_rad_s"):
        assert getattr(again.reference, name) == pytest.approx(getattr(nominal.reference, name), abs=0)
    assert again.reference.root_ang_vel_w == pytest.approx(nominal.reference.root_ang_vel_w, abs=1e-12)


def test_a_stored_motion_is_what_the_prior_aims_at(found, tmp_path):
    """On resume nothing is computed again: the stored targets are the base action's."""
    robot, reference, _, nominal, _ = found
    nominal.save(tmp_path / "motion.npz")
    settings = PriorSettings(kind="feedforward", aim="feasible")
    base = build_prior(settings, robot, reference, 0.25, stored=tmp_path / "motion.npz")
    targets = robot.default_pos_rad + 0.25 * base.targets.double().numpy()
    assert targets == pytest.approx(nominal.targets_rad, abs=1e-5)


def test_a_lifted_foot_is_found_too():
    """Where the bundled side kick lifts its foot: each tick found is MuJoCo's, and the foot is up."""
    robot = g1()
    clip = open_motion("side_kick", robot)
    frames = slice(round(1.6 * clip.fps), round(2.6 * clip.fps) + 1)
    cut = {name: getattr(clip, name)[frames] for name in ("root_pos_w", "root_quat_wxyz", "joint_pos_rad", "contact")}
    reference = build_reference(replace(clip, **cut), robot)
    wanted = Nominal(reference, feedforward_targets(linearization_model(robot), robot, reference))
    found = feasible_motion(robot, wanted, ground_lift_m(robot, reference), threads=2, progress=lambda line: None)
    assert found is not wanted
    away = np.linalg.norm(found.reference.root_pos_w - reference.root_pos_w, axis=1)
    assert away.max() < 0.06
    qpos, qvel, _ = generalized_motion(found.reference)
    model = compile_model(robot, timestep_s=0.005, actuation="pd_position", strip_visuals=True)
    data = mujoco.MjData(model)
    worst, lifted = 0.0, 0.0
    for tick, targets in enumerate(found.targets_rad[:-1]):
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos[tick], qvel[tick], targets
        mujoco.mj_step(model, data, 4)
        worst = max(worst, float(np.abs(data.qpos - qpos[tick + 1]).max()))
        feet = [data.body(name).xpos[2] for name in ("left_ankle_roll_link", "right_ankle_roll_link")]
        lifted = max(lifted, abs(feet[0] - feet[1]))
    assert worst < 1e-3
    assert lifted > 0.1


def test_flight_is_beyond_it():
    """The wanted root climbs a metre in half a second: what was wanted comes back, and the run is told."""
    robot = g1()
    clip = swaying_clip(robot, 0.5)
    root = clip.root_pos_w.copy()
    root[:, 2] += np.linspace(0.0, 1.0, len(root))
    reference = build_reference(replace(clip, root_pos_w=root), robot)
    wanted = Nominal(reference, feedforward_targets(linearization_model(robot), robot, reference))
    lines: list[str] = []
    nothing = np.zeros(len(reference.root_pos_w))
    assert feasible_motion(robot, wanted, nothing, threads=2, progress=lines.append) is wanted
    assert "none found" in lines[-1]
