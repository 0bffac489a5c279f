"""Every bundled clip can be performed: contacts, limits, balance and torques by MuJoCo and finite differences."""

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from motion.author.cli import CLIPS, choreography_names
from motion.clip import Clip, load_clip
from motion.physics_checks import is_stable
from motion.report.trace import trace_clip
from robot.robot import Robot
from tests.motion.checks import com_cop_m, sunk_m, within_limits
from world.model import compile_model

# name: shortest and longest duration [s], fastest joint [rad/s], smallest margin of the zero-moment point [m],
# smallest margin of the centre of mass where it is meant to stay above the feet [m]
EXPECTED = {
    "stand": (20.0, 20.0, 0.0, 0.05, 0.05),
    "taichi": (15.0, 20.0, 3.0, 0.02, 0.015),
    "horse_stance_punch": (8.0, 13.0, 6.5, 0.008, None),
    "side_kick": (6.0, 10.0, 6.0, 0.015, 0.015),
    "steps": (20.0, 25.0, 7.0, 0.008, None),
    "charleston": (8.0, 12.0, 6.5, 0.02, None),
}
GRAVITY_M_S2 = 9.81


@dataclass
class Played:
    clip: Clip
    com_w: np.ndarray  # (N,3)
    angular_momentum: np.ndarray  # (N,3) about the centre of mass
    soles_w: np.ndarray  # (N,2,S,3)
    self_contacts: set
    torque_nm: np.ndarray  # (N,J)
    mass_kg: float


@pytest.fixture(scope="module", params=sorted(EXPECTED))
def played(request, robot: Robot) -> Played:
    return play(load_clip(CLIPS / f"{request.param}.npz"), robot)


def name_of(played: Played) -> str:
    lengths = {name: load_clip(CLIPS / f"{name}.npz").sha256 for name in EXPECTED}
    return next(name for name, digest in lengths.items() if digest == played.clip.sha256)


def play(clip: Clip, robot: Robot) -> Played:
    model = compile_model(robot, timestep_s=0.02)
    data, dt = mujoco.MjData(model), 1.0 / clip.fps
    qpos = np.concatenate([clip.root_pos_w, clip.root_quat_wxyz, clip.joint_pos_rad], axis=1)
    qvel, count = np.zeros((len(qpos), model.nv)), len(qpos)
    for i in range(1, count - 1):
        mujoco.mj_differentiatePos(model, qvel[i], 2 * dt, qpos[i - 1], qpos[i + 1])
    qacc = np.gradient(qvel, dt, axis=0)
    com, momentum, soles, torque, touching = np.empty((count, 3)), np.empty((count, 3)), [], [], set()
    for i in range(count):
        data.qpos[:], data.qvel[:] = qpos[i], qvel[i]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        com[i], momentum[i] = data.subtree_com[1], data.subtree_angmom[1]
        touching |= {pair for pair in contacts(model, data) if "floor" not in pair}
        feet = [data.body(foot) for foot in robot.feet]
        soles.append(
            [f.xpos + robot.sole_points_m[n] @ f.xmat.reshape(3, 3).T for f, n in zip(feet, robot.feet, strict=True)]
        )
        torque.append(torques(model, data, qacc[i], clip.contact[i], robot, np.array(soles[-1])))
    return Played(clip, com, momentum, np.array(soles), touching, np.array(torque), float(model.body_mass.sum()))


def contacts(model: mujoco.MjModel, data: mujoco.MjData) -> set:
    deep = [contact.geom for contact in data.contact if contact.dist < 0]
    return {tuple(sorted(model.geom(g).name for g in pair)) for pair in deep}


def torques(model, data, qacc, contact, robot, soles) -> np.ndarray:
    """Joint torques when the ground carries the robot under the standing soles, by their share of the weight."""
    data.qacc[:] = qacc
    needed = np.zeros(model.nv)
    flags = model.opt.disableflags
    model.opt.disableflags = flags | mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    mujoco.mj_inverse(model, data)
    model.opt.disableflags = flags
    needed[:] = data.qfrc_inverse
    middles = soles.mean(axis=1)
    if contact.all():
        line = middles[0, :2] - middles[1, :2]
        left = np.clip((data.subtree_com[1, :2] - middles[1, :2]) @ line / (line @ line), 0.0, 1.0)
        share = np.array([left, 1.0 - left])
    else:
        share = contact
    force = needed[:3].copy()
    jacobian = np.empty((3, model.nv))
    for foot, part, middle in zip(robot.feet, share, middles, strict=True):
        mujoco.mj_jac(model, data, jacobian, None, middle, model.body(foot).id)
        needed -= part * jacobian.T @ force
    return needed[6:]


def zero_moment_point(played: Played) -> np.ndarray:
    """(N,2) from the rates of linear and angular momentum."""
    dt = 1.0 / played.clip.fps
    acceleration = np.gradient(np.gradient(played.com_w, dt, axis=0), dt, axis=0)
    spin = np.gradient(played.angular_momentum, dt, axis=0)
    up = played.mass_kg * (acceleration[:, 2] + GRAVITY_M_S2)
    lever = played.com_w[:, 2:] * played.mass_kg * acceleration[:, :2] / up[:, None]
    return played.com_w[:, :2] - lever - np.stack([spin[:, 1], -spin[:, 0]], axis=1) / up[:, None]


def margins(played: Played, points: np.ndarray) -> np.ndarray:
    """(N,) how far inside the hull of the standing soles each point is [m]."""
    result = np.empty(len(points))
    for i, (contact, soles) in enumerate(zip(played.clip.contact, played.soles_w, strict=True)):
        hull = ConvexHull(soles[contact > 0.5][..., :2].reshape(-1, 2))
        result[i] = -(hull.equations[:, :2] @ points[i] + hull.equations[:, 2]).max()
    return result


def test_every_choreography_has_its_clip_and_its_expectations():
    assert set(choreography_names()) == set(EXPECTED)
    assert {path.stem for path in CLIPS.glob("*.npz")} == set(EXPECTED)


def test_says_where_it_comes_from(played: Played, robot: Robot):
    clip = played.clip
    assert (clip.source, clip.license, clip.created_by) == (
        "kata choreography",
        "Apache-2.0",
        "kata motion/author",
    )
    assert clip.fps == 50.0
    assert clip.joint_names == robot.joint_names


def test_lasts_as_long_as_asked(played: Played):
    shortest, longest, *_ = EXPECTED[name_of(played)]
    assert shortest <= played.clip.duration_s <= longest


def test_begins_and_ends_at_rest_in_the_stand_pose(played: Played, robot: Robot):
    clip = played.clip
    for frame, neighbour in ((0, 1), (-1, -2)):
        np.testing.assert_allclose(clip.joint_pos_rad[frame], robot.default_pos_rad, atol=1e-6)
        np.testing.assert_allclose(clip.root_quat_wxyz[frame], [1, 0, 0, 0], atol=1e-6)
        np.testing.assert_allclose(clip.root_pos_w[frame, :2], 0.0, atol=1e-6)
        assert np.abs(clip.joint_pos_rad[neighbour] - clip.joint_pos_rad[frame]).max() * clip.fps < 2e-3
        np.testing.assert_allclose(played.soles_w[frame, :, :, 2], 0.0, atol=1e-6)
        assert clip.contact[frame].all()


def test_standing_feet_neither_slide_nor_sink_nor_float(played: Played):
    assert played.soles_w[..., 2].min() > -1e-3
    for foot in range(2):
        down = played.clip.contact[:, foot] > 0.5
        assert played.soles_w[down, foot, :, 2].max() < 3e-3
        edges = np.flatnonzero(np.diff(np.concatenate(([0], down, [0]))))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            places = played.soles_w[first:end, foot, :, :2]
            assert np.linalg.norm(places - places[0], axis=-1).max() < 1e-3


def test_swinging_feet_clear_the_ground(played: Played):
    for foot in range(2):
        up = played.clip.contact[:, foot] < 0.5
        edges = np.flatnonzero(np.diff(np.concatenate(([0], up, [0]))))
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            assert played.soles_w[first:end, foot, :, 2].min(axis=1).max() > 0.035


def test_keeps_joint_limits_and_speeds(played: Played, robot: Robot):
    lower, upper = robot.soft_pos_limits_rad()
    assert (played.clip.joint_pos_rad >= lower - 1e-6).all() and (played.clip.joint_pos_rad <= upper + 1e-6).all()
    fastest = np.abs(np.diff(played.clip.joint_pos_rad, axis=0)).max() * played.clip.fps
    assert fastest <= EXPECTED[name_of(played)][2] + 1e-6
    assert np.abs(np.diff(played.clip.joint_pos_rad, 2, axis=0)).max() * played.clip.fps**2 < 80.0


def test_no_two_links_touch(played: Played):
    assert played.self_contacts == set()


def test_torques_are_within_half_of_what_the_motors_give(played: Played, robot: Robot):
    assert (np.abs(played.torque_nm).max(axis=0) / robot.torque_limit_nm).max() < 0.5


def test_zero_moment_point_stays_inside_the_standing_soles(played: Played):
    inside = margins(played, zero_moment_point(played))[2:-2]
    assert inside.min() > EXPECTED[name_of(played)][3]


def test_slow_clips_keep_the_centre_of_mass_above_the_feet(played: Played):
    margin = EXPECTED[name_of(played)][4]
    if margin is None:
        pytest.skip("a dynamic motion: its zero-moment point is what counts")
    assert margins(played, played.com_w[:, :2]).min() > margin


def test_passes_the_checks_of_every_clip(played: Played, robot: Robot):
    report = trace_clip(played.clip, robot)
    assert is_stable(com_cop_m(played.clip, robot), played.clip.fps)
    assert report.max_slide_m < 3e-3 and sunk_m(report) < 2e-3
    assert within_limits(report)
    assert report.self_collisions == {}


def test_contact_flags_are_heights(played: Played):
    for foot in range(2):
        low = played.soles_w[:, foot, :, 2].max(axis=1) < 1.9e-3
        assert (played.clip.contact[low, foot] == 1.0).all()
        assert set(np.unique(played.clip.contact)) <= {0.0, 1.0}


def test_charleston_swings_arms_against_legs(robot: Robot):
    clip = load_clip(CLIPS / "charleston.npz")
    column = {name: clip.joint_pos_rad[:, i] for i, name in enumerate(clip.joint_names)}
    legs = column["left_hip_pitch_joint"] - column["right_hip_pitch_joint"]
    arms = column["left_shoulder_pitch_joint"] - column["right_shoulder_pitch_joint"]
    assert np.corrcoef(legs, arms)[0, 1] < -0.5


def test_taichi_steps_once_out_and_once_back():
    clip = load_clip(CLIPS / "taichi.npz")
    lifts = [int(a - b) for b, a in pairwise(clip.contact[:, 0])]
    assert lifts.count(-1) == lifts.count(1) == 2
    assert clip.contact[:, 1].all()
