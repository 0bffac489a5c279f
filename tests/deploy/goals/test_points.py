"""Points of the body by datagrams: what the guard lets through by hand, beside a clip's, and 1,000 hostile ones."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InputError
from core.rotations import quat_from_rotvec, quat_mul, quat_rotate, quat_rotate_inverse
from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.control.modes import Mode
from deploy.goals.clip import ClipGoal
from deploy.goals.guard import NOBODY, GoalGuard, Steer
from deploy.goals.message import LARGEST, decode, encode, encode_points
from deploy.goals.points import TRACKED, PointGuard
from deploy.goals.settings import PointRange
from deploy.goals.steering import SteerGoal
from motion.reference import Reference
from motion.steering import steering_of
from policy.goals import visible_in
from tests.deploy.goals.toys import Hand, Stage, column, standing_run, write_goal_actor
from tests.deploy.toys import PERIOD_S, ROBOT, SETTINGS, state
from world.scene import Scene

POINTS = SETTINGS.goals.points
LOW, HIGH = (np.array([getattr(getattr(POINTS, name), end) for name in TRACKED]) for end in ("low", "high"))
COLUMNS = ROBOT.tracked_index(["right_hand_link", "left_hand_link", "head_link"])
HANDS_OUT = (0.3, -0.2, 1.0, 0.3, 0.2, 1.0, 0.05, 0.0, 1.2, 0.0, 0.2, 0.1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("points")
    write_goal_actor(made / "goals.onnx")
    return made


@pytest.fixture(scope="module")
def stand(folder):
    return standing_run(folder)


@pytest.fixture(scope="module")
def loaded(folder):
    """The goal actor with the bundled clip of standing, read once. Each test makes its own run of it."""
    return load_run(folder / "goals.onnx", "stand", ROBOT, SETTINGS.entry)


@pytest.fixture
def guard(stand):
    return PointGuard(SETTINGS.goals, ROBOT, stand.goals.setting)


def turn_about_z(angle_rad):
    return np.array([math.cos(angle_rad / 2), 0.0, 0.0, math.sin(angle_rad / 2)])


def test_the_message_byte_by_byte():
    wanted = b"KATA" + bytes([2, 0, 2, 0, 7, 0, 0, 0])
    wanted += struct.pack("<3f", 0.25, -0.5, 1.0) + struct.pack("<9f", *range(1, 10)) + struct.pack("<4f", 0, 0, 0, 1)
    message = encode_points(7, (0.25, -0.5, 1.0), (1, 2, 3), (4, 5, 6), (7, 8, 9), (0, 0, 0, 1))
    assert message == wanted and len(message) == LARGEST == 76
    number, heard = decode(message)
    assert number == 7 and (heard.forward_m_s, heard.left_m_s, heard.turn_rad_s) == (0.25, -0.5, 1.0)
    assert heard.points == pytest.approx((*range(1, 10), 0.0, 0.0, math.pi))
    reach = encode_points(8, (0.0, 0.0, 0.0), (1, 2, 3))
    assert len(reach) == 76 and reach[6:8] == b"\1\0" and decode(reach)[1].points == (1, 2, 3)


def test_points_may_be_arrays_and_none_is_left_out_unsaid():
    places = np.arange(1.0, 10.0).reshape(3, 3)
    message = encode_points(7, np.array([0.25, -0.5, 1.0]), *places, np.array([0.0, 0.0, 0.0, 1.0]))
    assert message == encode_points(7, (0.25, -0.5, 1.0), (1, 2, 3), (4, 5, 6), (7, 8, 9), (0, 0, 0, 1))
    for some in ((places[1],), (None, places[2]), (places[1], places[2])):
        with pytest.raises(ValueError, match="expected the right hand alone, or both hands, the head and its rotation"):
            encode_points(7, (0.0, 0.0, 0.0), places[0], *some)


def test_what_is_no_message_is_none():
    good = encode_points(1, (0.0, 0.0, 0.0), (0.3, -0.2, 1.0), (0.3, 0.2, 1.0), (0.0, 0.0, 1.2), (1, 0, 0, 0))
    nan = struct.pack("<f", math.nan)
    bad = [good[:-1], good + b"x", b"kata" + good[4:], good[:4] + b"\1\0" + good[6:], good[:6] + b"\0\0" + good[8:]]
    bad += [good[:6] + b"\3\0" + good[8:], good[:12] + nan + good[16:], good[:24] + nan + good[28:]]
    bad += [good[:-4] + nan, good[:-4] + struct.pack("<f", 0.3), encode(1, 0, 0, 0)[:4] + b"\2\0" + good[6:24]]
    assert decode(good) is not None and [decode(datagram) for datagram in bad] == [None] * len(bad)


def test_points_begin_where_the_stand_actor_has_them_and_go_no_faster_than_their_rate(guard):
    """By hand: hands move at 2.5 m/s, or 50 mm a tick, in a straight line; the head at 1 m/s, or 20 mm."""
    rest = guard.values
    assert rest[0] == pytest.approx(rest[1] * [1.0, -1.0, 1.0], abs=1e-4)
    assert rest[2, 2] == pytest.approx(1.249, abs=2e-3)
    guard.next(HANDS_OUT)
    moved = np.linalg.norm(guard.values - rest, axis=1)
    assert guard.kind == "vr3" and moved == pytest.approx([0.05, 0.05, 0.02, 0.05])
    way = (np.array(HANDS_OUT).reshape(4, 3) - rest)[0]
    assert (guard.values - rest)[0] == pytest.approx(0.05 * way / np.linalg.norm(way))
    for _ in range(20):
        guard.next(HANDS_OUT)
    assert guard.values.ravel() == pytest.approx(HANDS_OUT) and not guard.rested


def test_points_beyond_their_range_end_at_its_edge(guard):
    for _ in range(100):
        guard.next((9.0, -9.0, 9.0, -9.0, 9.0, -9.0, 9.0, 9.0, 0.0, -3.0, 3.0, 0.1))
    assert guard.values == pytest.approx(
        np.array([[0.5, -0.65, 1.5], [-0.15, 0.65, 0.5], [0.35, 0.25, 0.95], [-0.4, 0.9, 0.1]])
    )


def test_a_point_goes_on_and_slows_down(guard):
    """By hand: 1 m/s up; after t it is 0.1 (1 - exp(-t / 0.1)) m farther, and never beyond its range."""
    for tick in range(20):
        guard.next((0.2, -0.2, 0.7 + 0.02 * tick))
    for tick in range(20, 35):
        guard.next((0.2, -0.2, 0.7 + 0.02 * tick))
    ahead = guard.ahead(np.array([0.0, 0.02, 0.1, 0.34]))[:, 0]
    assert guard.kind == "reach" and guard.values[0] == pytest.approx([0.2, -0.2, 1.38])
    assert ahead[:, :2] == pytest.approx(np.tile([0.2, -0.2], (4, 1)), abs=1e-6)
    assert ahead[:, 2] == pytest.approx([1.38, 1.38 + 0.018127, 1.38 + 0.063212, 1.38 + 0.096663], abs=1e-4)
    for tick in range(35, 41):
        guard.next((0.2, -0.2, 0.7 + 0.02 * tick))
    assert guard.values[0, 2] == pytest.approx(1.5) and guard.ahead(np.array([0.34]))[0, 0, 2] == 1.5


def test_points_are_above_the_floor_wherever_that_is(loaded, stand):
    """On a floor 1 m lower, the actor sees the same numbers."""
    low, seen = stand.goals.setting, []
    moved = {name: getattr(low, name) - [0.0, 0.0, 1.0] for name in ("root_pos_w", "body_pos_w")}
    for standing in (low, replace(low, scene=Scene(floor_m=-1.0), **moved)):
        hand, points = Hand(), PointGuard(SETTINGS.goals, ROBOT, standing)
        goal = SteerGoal("udp", hand, standing, GoalGuard(SETTINGS.goals, PERIOD_S), points)
        run = ActorRun(loaded.actor, ROBOT, SETTINGS.entry, goal)
        run.start()
        hand.steer = Steer(0.2, 0.0, 0.1, points=HANDS_OUT)
        seen.append([run.act(state()).observation["obs"] for _ in range(30)])
    assert seen[1][-1] == pytest.approx(seen[0][-1], abs=1e-6)
    assert seen[0][-1][column("goal_point", "right_hand")][2] == pytest.approx(1.0)


SILENCES = [NOBODY, Steer(0.1, 0.0, 0.0, 0.26, HANDS_OUT), Steer(0.1, 0.0, 0.0, 0.0, (math.nan,) * 3)]


def test_a_slow_point_is_at_rest_in_half_a_second_too(stand):
    """From the corner that is farthest away, where the rate alone would take a minute."""
    slow = replace(POINTS, **{name: replace(getattr(POINTS, name), per_s=0.01) for name in TRACKED})
    guard = PointGuard(replace(SETTINGS.goals, points=slow), ROBOT, stand.goals.setting)
    rest = guard.values
    guard.kind, guard.values = "vr3", np.where(HIGH - rest > rest - LOW, HIGH, LOW)
    for _ in range(24):
        guard.next(None)
    assert not guard.rested
    guard.next(None)
    assert guard.values == pytest.approx(rest, abs=1e-9)


@pytest.mark.parametrize("silence", SILENCES)
def test_where_nobody_is_heard_all_comes_to_rest_and_is_over_after_two_seconds(stand, guard, silence):
    hand = Hand()
    goal = SteerGoal("udp", hand, stand.goals.setting, GoalGuard(SETTINGS.goals, PERIOD_S), guard)
    goal.start()
    rest = guard.values
    hand.steer = Steer(0.0, 0.0, 0.0, points=HANDS_OUT)
    for _ in range(200):
        goal.next(0.0)
    assert not goal.resting
    hand.steer = silence
    shown = [goal.next(0.0) for _ in range(25)]
    assert guard.rested and np.array_equal(guard.values, rest) and not goal.finished
    assert np.array_equal(shown[0].visible, visible_in("vr3"))
    shown = [goal.next(0.0) for _ in range(75)]
    assert goal.finished and np.array_equal(shown[-1].visible, visible_in("full"))
    goal.start()
    hand.steer = Steer(0.0, 0.0, 0.0)
    assert np.array_equal(goal.next(0.0).visible, visible_in("steer")) and not goal.finished


FINE = 40  # steps of a tick in which a way is worked out


def walking(standing: Reference, ticks: int, speed_m_s: float, turn_rad_s: float) -> Reference:
    """Hands out, the head turned, at this speed ahead, and a turn that rises slowly; 0.3 rad from north at first."""
    rate = np.minimum(turn_rad_s, 0.03 * np.arange(ticks * FINE + 1) / FINE)
    heading = 0.3 + np.concatenate([[0.0], np.cumsum(rate[:-1])]) * PERIOD_S / FINE
    way = np.cumsum(speed_m_s * PERIOD_S / FINE * np.exp(1j * (heading + 0.5 * rate * PERIOD_S / FINE)))
    way = np.concatenate([[0.0], way[:-1]])[::FINE]
    place, heading = np.stack([2.0 + way.real, way.imag - 1.0, np.zeros(ticks + 1)], axis=-1), heading[::FINE]
    quat = np.stack([turn_about_z(angle) for angle in heading])
    tables = {
        name: np.repeat(value[:1], ticks + 1, axis=0).copy()
        for name, value in vars(standing).items()
        if isinstance(value, np.ndarray)
    }
    points = np.array(HANDS_OUT).reshape(4, 3)
    for index, point in zip(COLUMNS, points):
        tables["body_pos_w"][:, index] = place + quat_rotate(quat, np.tile(point, (ticks + 1, 1)))
    tables["body_quat_wxyz"][:, COLUMNS[2]] = quat_mul(quat, np.tile(quat_from_rotvec(points[3]), (ticks + 1, 1)))
    tables |= {"root_pos_w": np.add(place, [0.0, 0.0, 0.75]), "root_quat_wxyz": quat}
    tables["feedforward_rad"] = np.zeros_like(tables["joint_pos_rad"])
    speeds = np.tile([speed_m_s, 0.0], (ticks + 1, 1))
    tables["steering"] = np.column_stack([speeds, rate[::FINE], heading])
    return replace(standing, **tables, duration_s=ticks * PERIOD_S)


def said(sender, reference, tick, kind):
    """What a sender says of a reference at a tick: points in the frame of its smooth heading, and its speeds."""
    heading = reference.steering[:, 3] - reference.steering[0, 3] + yaw(reference, 0)
    frame = turn_about_z(heading[tick])
    away = reference.body_pos_w[tick, COLUMNS] - reference.root_pos_w[tick] * [1.0, 1.0, 0.0]
    right, left, head = quat_rotate_inverse(np.tile(frame, (3, 1)), away).tolist()
    quat = quat_mul(frame * [1, -1, -1, -1], reference.body_quat_wxyz[tick, COLUMNS[2]]).tolist()
    turn = (heading[tick + 1] - heading[tick]) / PERIOD_S
    speeds = (*reference.steering[tick + 1, :2], turn)
    sender.number += 1
    sender.raw(encode_points(sender.number, speeds, right, *((left, head, quat) if kind == "vr3" else ())))


def yaw(reference, tick):
    return 2.0 * math.atan2(reference.root_quat_wxyz[tick, 3], reference.root_quat_wxyz[tick, 0])


def runs_of(loaded, stand, port, reference, kind):
    """The same actor behind the clip source and behind datagrams."""
    clip = ClipGoal("it", loaded.clip, reference, loaded.start_pose_rad, kind)
    points = PointGuard(SETTINGS.goals, ROBOT, stand.goals.setting)
    udp = SteerGoal("udp", port, stand.goals.setting, GoalGuard(SETTINGS.goals, PERIOD_S), points)
    runs = [ActorRun(loaded.actor, ROBOT, SETTINGS.entry, goal) for goal in (clip, udp)]
    for one in runs:
        one.start()
    return runs


def seen_by_both(loaded, stand, port, sender, reference, kind, ticks, settle=0):
    by_clip, by_udp = runs_of(loaded, stand, port, reference, kind)
    for tick in range(ticks):
        said(sender, reference, tick, kind)
        pose = state(imu_quat_wxyz=turn_about_z(1.1 + yaw(reference, tick) - yaw(reference, 0)))
        seen = [run.act(pose).observation["obs"] for run in (by_clip, by_udp)]
        if tick >= settle:
            yield seen


@pytest.mark.parametrize("kind", ["vr3", "reach"])
@pytest.mark.parametrize(("speed_m_s", "turn_rad_s"), [(0.0, 0.0), (0.4, 0.0), (0.0, 0.5), (0.4, 0.5)])
def test_the_points_of_a_clip_by_datagrams_are_what_the_clip_shows(
    loaded, stand, port, sender, kind, speed_m_s, turn_rad_s
):
    """Every number that the actor sees of the goal, at all ticks ahead, once the guard has come after the first jump.

    Steady speed and points that rest in the moving frame: what lies ahead is then known.
    """
    reference = walking(stand.goals.setting, 150, speed_m_s, turn_rad_s)
    goal = slice(column("reference_joint_error").start, None)
    for by_clip, by_udp in seen_by_both(loaded, stand, port, sender, reference, kind, 100, settle=60):
        assert np.abs(by_clip[goal]).max() > 0.2 and by_udp[goal] == pytest.approx(by_clip[goal], abs=3e-6)
    assert port.counts == {"taken": 100, "malformed": 0, "late": 0}


def test_a_recorded_clip_by_datagrams_is_seen_a_moment_ahead_and_roughly_farther_on(
    folder, loaded, stand, port, sender
):
    """The lookahead is assumed. Mean errors on the bundled `taichi`, 8 s; a hand's way in 17 ticks is the measure."""
    run = load_run(folder / "goals.onnx", "taichi", ROBOT, SETTINGS.entry, "vr3")
    reference = run.reference
    assert np.array_equal(reference.steering, steering_of(reference))
    errors, ways, turns = [], [], []
    for by_clip, by_udp in seen_by_both(loaded, stand, port, sender, reference, "vr3", 400, settle=50):
        off = {point: (by_udp - by_clip)[column("goal_point", point)].reshape(3, 3) for point in ("left_hand", "head")}
        shown = by_clip[column("goal_point", "left_hand")].reshape(3, 3)
        errors.append([np.linalg.norm(off["left_hand"], axis=1), np.linalg.norm(off["head"], axis=1)])
        ways.append(np.linalg.norm(shown[2] - shown[0]))
        turns.append(np.abs((by_udp - by_clip)[column("goal_turn", "head")])[:6].max())
    hand_mm, head_mm = 1e3 * np.mean(errors, axis=0)
    assert hand_mm[0] < 1.0 and head_mm[0] < 0.5 and np.mean(turns) < 2e-3
    assert hand_mm[2] < 0.8 * 1e3 * np.mean(ways)


def hostile(rng, number):
    """A datagram: of either version and any kind, huge, jumping, damaged, cut; None: nothing comes."""
    scale = 10.0 ** rng.integers(-3, 30) if rng.random() < 0.4 else 1.0
    right, left, head, speeds = (vector.tolist() for vector in rng.normal(0.0, scale, (4, 3)))
    quat = rng.normal(size=4)
    quat = (quat if rng.random() < 0.2 else quat / np.linalg.norm(quat)).tolist()
    others = (left, head, quat) if rng.random() < 0.7 else ()
    good = encode(number, *speeds) if rng.random() < 0.2 else encode_points(number, speeds, right, *others)
    damaged = bytearray(good)
    if rng.random() < 0.3:
        damaged[rng.integers(len(good))] = rng.integers(256)
        damaged = damaged[: rng.integers(len(good) + 1)] + rng.bytes(rng.integers(3))
    return bytes(damaged) if rng.random() < 0.9 else None


def test_a_thousand_hostile_datagrams_leave_all_within_ranges_and_rates(loaded, stand, port, sender):
    rng = np.random.default_rng(11)
    points = PointGuard(SETTINGS.goals, ROBOT, stand.goals.setting)
    goal = SteerGoal("udp", port, stand.goals.setting, GoalGuard(SETTINGS.goals, PERIOD_S), points)
    run = ActorRun(loaded.actor, ROBOT, SETTINGS.entry, goal)
    run.start()
    # m/s and rad/s; the head's is that of a stop: 0.52 m at most in 0.5 s
    rates, before, moved = np.array([2.5, 2.5, 1.05, 2.5]) * PERIOD_S, points.values, 0
    for number in range(1000):
        if (datagram := hostile(rng, number)) is not None:
            sender.raw(datagram)
        output = run.act(state(imu_quat_wxyz=turn_about_z(rng.uniform(-3, 3))))
        assert np.isfinite(output.action).all() and np.isfinite(output.observation["obs"]).all()
        assert (points.values >= LOW).all() and (points.values <= HIGH).all()
        assert (np.linalg.norm(points.values - before, axis=1) <= rates + 1e-9).all()
        ahead = points.ahead(PERIOD_S * np.arange(18))
        assert (ahead >= LOW).all() and (ahead <= HIGH).all()
        moved += not np.array_equal(points.values, before)
        before = points.values
    assert moved > 500 and port.counts["taken"] > 300 and port.counts["malformed"] > 100


def test_a_robot_in_the_loop_stands_through_a_thousand_hostile_datagrams_and_after_them(actors, port, sender):
    """20 s of them in MuJoCo, then silence: HOLD, no fault, and no torque beyond the limits."""
    stage, rng = Stage(actors), np.random.default_rng(12)
    setting = stage.stand.goals.setting
    points = PointGuard(SETTINGS.goals, ROBOT, setting)
    run = stage.cell.machine.tracked[0]
    run.goals = SteerGoal("udp", port, setting, GoalGuard(SETTINGS.goals, PERIOD_S), points)
    kinds = set()

    def send(tick):
        kinds.add(points.kind)
        if 0 < tick <= 1000 and (datagram := hostile(rng, tick)) is not None:
            sender.raw(datagram)
        return Steer(0.0, 0.0, 0.0)

    stage.steer = send
    stage.run()
    assert stage.cell.machine.fault is None and stage.tracked >= 1000 and kinds == {"steer", "reach", "vr3"}
    assert stage.modes[-3:] == [Mode.HOLD, Mode.LOWERING, Mode.DAMPING] and port.counts["malformed"] > 100
    for command, reading in zip(stage.commands, stage.states):
        torque = command.kp * (command.q_rad - reading.joint_pos_rad) - command.kd * reading.joint_vel_rad_s
        assert np.isfinite(command.q_rad).all() and (np.abs(torque) <= ROBOT.torque_limit_nm + 1e-6).all()


def test_a_range_that_is_none_is_refused():
    with pytest.raises(InputError, match=r"high\[1\]: too small, got -0\.2, expected at least 0\.0"):
        PointRange((0.0, 0.0, 0.0), (0.1, -0.2, 0.1), 1.0)
