"""Which state is scored against which row, where the reference is laid, and what counts as a fall."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from core.rotations import yaw_of
from deploy.control.modes import Mode
from deploy.control.states import StateMachine
from deploy.control.tick import Tick
from deploy.goals.source import Goal
from deploy.record.recorder import Performance, Recorder, align_heading, has_fallen
from deploy.safety.guard import Guard
from motion.metrics import METRIC_KEYS
from policy.goals import visible_in
from tests.deploy.toys import HEIGHT_M, PERIOD_S, ROBOT, SETTINGS, linear_run, state
from world.plant import TrueState
from world.scene import FLAT, Box, Scene

KINEMATICS = ROBOT.kinematics


def turned(yaw: float) -> np.ndarray:
    return np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


def truth(position, yaw=0.0, joints=None) -> TrueState:
    return TrueState(
        root_pos_w=np.asarray(position, dtype=float),
        root_quat_wxyz=turned(yaw),
        root_lin_vel_w=np.zeros(3),
        root_ang_vel_b=np.zeros(3),
        joint_pos_rad=ROBOT.default_pos_rad if joints is None else joints,
        joint_vel_rad_s=np.zeros(ROBOT.num_joints),
        foot_contact=np.array([True, False]),
    )


@pytest.fixture
def run(tmp_path):
    return linear_run(tmp_path, seconds=0.2)


def play(run, states):
    """Feed states as the loop would, the first being the one at which TRACKING starts."""
    machine = StateMachine(ROBOT, None, [run], SETTINGS, PERIOD_S)
    machine.start_tracking()
    tick, recorder = Tick(machine, Guard(ROBOT, SETTINGS, PERIOD_S)), Recorder()
    modes = []
    for reading in states:
        result = tick(reading)
        recorder(reading, result, None)
        modes.append(result.mode)
    return recorder.performance, modes


def test_row_k_is_the_state_after_tick_k(run):
    states = [state(truth=truth([0.01 * k, 0.0, HEIGHT_M])) for k in range(15)]
    performance, modes = play(run, states)
    assert modes.count(Mode.TRACKING) == performance.num_steps == run.num_ticks == 10
    np.testing.assert_allclose([row[0] for row in performance.root_pos_w], 0.01 * np.arange(1, 11))


def test_metrics_of_a_shift_known_by_hand(run):
    """Standing 30 mm ahead of where it started: 30 mm in the world, 0 relative to the root; half the contacts wrong."""
    states = [state(truth=truth([2.0, 1.0, HEIGHT_M], yaw=0.5))]
    ahead = [2.0 + 0.03 * np.cos(0.5), 1.0 + 0.03 * np.sin(0.5), HEIGHT_M]
    states += [state(truth=truth(ahead, yaw=0.5))] * 12
    performance, _ = play(run, states)
    metrics = performance.metrics(KINEMATICS)
    assert tuple(sorted(metrics)) == tuple(sorted(METRIC_KEYS))
    assert metrics["eg_mpbpe_mm"] == pytest.approx(30.0, abs=1e-6)
    for name in ("empbpe_mm", "empjpe_mrad", "empjve_mrad", "empbve_mm", "empbae_mm"):
        assert metrics[name] == pytest.approx(0.0, abs=1e-6)
    assert metrics["contact_error"] == 0.5 and metrics["episode_length_ratio"] == 1.0


def test_true_joints_are_scored_where_they_are_known(run):
    off = ROBOT.default_pos_rad.copy()
    off[3] += 0.03
    off[4] += 0.04
    states = [state(truth=truth([0, 0, HEIGHT_M], joints=off), joint_pos_rad=ROBOT.default_pos_rad + 0.1)] * 12
    assert play(run, states)[0].metrics(KINEMATICS)["empjpe_mrad"] == pytest.approx(50.0, abs=1e-6)


def test_without_truth_only_what_can_be_known(run):
    """Yaw is the IMU's and aligned at the start; the world is not known."""
    states = [state(imu_quat_wxyz=turned(1.0))] * 12
    performance, _ = play(run, states)
    metrics = performance.metrics(KINEMATICS)
    unknown = {name for name, value in metrics.items() if value is None}
    assert unknown == {"eg_mpbpe_mm", "empbve_mm", "empbae_mm", "contact_error"}
    assert metrics["empbpe_mm"] == pytest.approx(0.0, abs=1e-6)


def test_a_fall_ends_the_episode_with_the_row_of_the_fall(run):
    states = [state(truth=truth([0, 0, HEIGHT_M if k < 5 else 0.29])) for k in range(12)]
    performance, _ = play(run, states)
    assert performance.fallen_at == 4 and performance.num_steps == 5
    assert performance.metrics(KINEMATICS)["episode_length_ratio"] == 0.5


def test_no_step_no_metrics(run):
    states = [state(truth=truth([0, 0, HEIGHT_M]))]
    assert set(play(run, states)[0].metrics(KINEMATICS).values()) == {None}


def test_heading_brings_the_first_row_to_the_robot_and_keeps_height_and_shape(run):
    reference = run.reference
    heading = align_heading(reference, np.array([3.0, -2.0, 0.5]), 2.0 - yaw_of(reference.root_quat_wxyz[0]))
    first = heading.points(reference.root_pos_w[0])
    np.testing.assert_allclose(first, [3.0, -2.0, HEIGHT_M], atol=1e-12)
    assert yaw_of(heading.rotations(reference.root_quat_wxyz[0])) == pytest.approx(2.0)
    bodies = heading.points(reference.body_pos_w[0])
    np.testing.assert_allclose(bodies[:, 2], reference.body_pos_w[0, :, 2], atol=1e-12)
    size = np.linalg.norm(reference.body_pos_w[0] - reference.body_pos_w[0, :1], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(bodies - bodies[:1], axis=-1), size, atol=1e-12)


def test_a_second_start_is_a_new_performance(run):
    recorder = Recorder()
    machine = StateMachine(ROBOT, None, [run], SETTINGS, PERIOD_S)
    tick = Tick(machine, Guard(ROBOT, SETTINGS, PERIOD_S))
    for _ in range(2):
        machine.start_tracking()
        for _ in range(14):
            reading = state(truth=truth([0, 0, HEIGHT_M]))
            recorder(reading, tick(reading), None)
    assert isinstance(recorder.performance, Performance) and recorder.performance.num_steps == 10


class Told:
    """A tick of TRACKING in which an actor was shown a goal; tick 1 is its first."""

    mode = Mode.TRACKING

    def __init__(self, tick, goal):
        self.actor = SimpleNamespace(tick=tick, goal=goal)


def test_of_a_script_each_clip_is_scored_where_it_was_asked_for_and_steering_by_its_heading(run):
    """By hand: it looks 0.5 rad from north at first, and is asked to turn to 0.2 on; a clip is turned by 0.3."""
    clip, recorder = run.reference, Recorder()
    steered = replace(clip, steering=np.tile([0.4, 0.0, 0.1, 0.2], (len(clip.root_pos_w), 1)))
    nothing = visible_in("none")
    recorder(state(truth=truth([0, 0, HEIGHT_M], yaw=0.5)), Told(1, Goal(steered, 0, 0.0, nothing, 0.0)), None)
    before = replace(steered, steering=steered.steering - [0.0, 0.0, 0.0, 0.6])
    recorder(state(truth=truth([1, 0, HEIGHT_M], yaw=0.6)), Told(2, Goal(before, 0, 0.0, nothing, 0.6)), None)
    assert list(recorder.off_rad) == pytest.approx([0.2, 0.1]) and recorder.performance is None
    ghost = recorder.laid.points(clip.root_pos_w[0])
    np.testing.assert_allclose(ghost, [1.0 + 0.4 * np.cos(0.7), 0.4 * np.sin(0.7), HEIGHT_M])
    assert yaw_of(recorder.laid.rotations(clip.root_quat_wxyz[0])) == pytest.approx(0.7 + 0.1)
    for tick in range(12):
        shown = Goal(clip, tick % 6, 0.0, nothing, 0.3, "kick" if tick < 6 else "punch")
        recorder(state(truth=truth([2, 1, HEIGHT_M], yaw=0.7)), Told(3 + tick, shown), None)
    assert [played.name for played in recorder.performances] == ["kick", "punch"]
    assert [played.num_steps for played in recorder.performances] == [6, 5] and len(recorder.off_rad) == 2
    heading = recorder.performances[0].heading
    np.testing.assert_allclose(heading.points(clip.root_pos_w[0])[:2], [2.0, 1.0])
    laid = yaw_of(heading.rotations(clip.root_quat_wxyz[0])) - yaw_of(clip.root_quat_wxyz[0])
    assert laid == pytest.approx(0.5 + 0.3)
    recorder(state(), Told(1, Goal(clip, 0, 0.0, nothing, None, "again")), None)
    assert [played.name for played in recorder.performances] == ["again"] and not recorder.off_rad


def test_a_fall_is_low_above_what_lies_under_the_root():
    table = Scene(-1.0, (Box((0.0, 0.0, 0.5), (0.5, 0.5, 0.5)),))
    assert [has_fallen(truth([0.0, 0.0, z]), FLAT) for z in (0.29, 0.31)] == [True, False]
    assert [has_fallen(truth([0.0, 0.0, z]), table) for z in (1.29, 1.31)] == [True, False]
    assert [has_fallen(truth([2.0, 0.0, z]), table) for z in (-0.71, -0.69)] == [True, False]
    assert has_fallen(truth([0.0, 0.0, np.nan]), FLAT) and has_fallen(truth([np.nan, 0.0, np.nan]), table)


@pytest.mark.parametrize("part", ["root_pos_w", "root_quat_wxyz", "joint_pos_rad"])
def test_a_state_that_is_not_finite_is_a_fall_and_the_rows_end_before_it(run, part):
    states = [state(truth=truth([0.0, 0.0, HEIGHT_M])) for _ in range(9)]
    diverged = replace(states[4].truth, **{part: getattr(states[4].truth, part) * np.nan})
    states[4:] = [replace(states[4], truth=diverged)] * 5
    performance, _ = play(run, states)
    assert performance.fallen_at == performance.num_steps == 3
    metrics = performance.metrics(KINEMATICS)
    assert metrics["episode_length_ratio"] == 3 / 10
    assert metrics["eg_mpbpe_mm"] == pytest.approx(0.0, abs=1e-9) and np.isfinite(list(metrics.values())).all()
