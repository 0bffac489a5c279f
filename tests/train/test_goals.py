"""Goals: what is hidden changes nothing, who is shown what, and the same in training, imagination and deployment."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from core.errors import InputError
from motion.clip import save_clip
from motion.steering import steering_of, with_steering
from motion.tables import with_tables
from policy.goals import KINDS, PARTS, POINTS, bits_of, visible_in
from policy.history import ObservationHistory
from policy.layouts import goals_actor_group
from policy.observation import reference_tables, sample_terms, term_dims, window_ticks
from policy.reference import window_at
from policy.terms import ObservationInput
from tests.train.test_many_clips import references
from tests.train.worlds import g1, observations_of_robots, settings, swaying_clip
from train.clip_warnings import unsteered
from train.config import compose_document
from train.mdp.factory import build_environment
from train.mdp.goals import Goals, GoalSettings, KindsOf, errors_by_kind, visible
from train.setup import new_setup

ROBOT = g1()
GROUP = goals_actor_group()
TICKS = window_ticks([GROUP])
JOINTS = np.arange(23)
AT = ROBOT.tracked_index(ROBOT.goal_points)
GOALS = {"observations": "goals", "critic": ["history", "reference_position"]}


def with_goals(reference):
    return with_steering(replace(reference, feedforward_rad=0.1 * reference.joint_pos_rad))


def seen(window, yaw_rad=0.4):
    """One sample of the layout of a robot in the default pose that is turned."""
    return sample_terms(
        ObservationHistory(GROUP, term_dims(23)).terms,
        ObservationInput(
            base_quat_wxyz=Rotation.from_euler("z", yaw_rad).as_quat(scalar_first=True),
            base_ang_vel_b=np.zeros(3),
            joint_pos_rad=ROBOT.default_pos_rad,
            joint_vel_rad_s=np.zeros(23),
            last_action=np.zeros(23),
            filtered_gravity_b=np.array([0.0, 0.0, -1.0]),
            phase=np.zeros(1),
            default_pos_rad=ROBOT.default_pos_rad,
            reference=window,
        ),
    )


def columns(term, of=""):
    """Where a term lies in one sample."""
    dims, first = term_dims(23), 0
    for entry in ObservationHistory(GROUP, dims).terms:
        size = dims[entry.term] * max(1, len(entry.ticks))
        if (entry.term, entry.of) == (term, of):
            return slice(first, first + size)
        first += size
    raise KeyError(term)


def kick_window(kind, tick=30, turn_rad=0.0, **changes):
    rows = replace(with_goals(references()["kick"]), **changes)
    return window_at(rows, tick, TICKS, JOINTS, turn_rad, points=AT, visible=visible_in(kind))


def test_a_point_is_seen_from_where_the_reference_is_now_and_by_the_robots_heading():
    kick = references()["kick"]
    sample = seen(kick_window("full", turn_rad=0.25), yaw_rad=0.4)
    hand, head = (ROBOT.tracked_names.index(name) for name in ("left_hand_link", "head_link"))
    away = kick.body_pos_w[47, hand] - [*kick.root_pos_w[30, :2], 0.0]  # 17 ticks ahead of 30
    expected = Rotation.from_euler("z", 0.25 - 0.4).apply(away)
    assert sample[columns("goal_point", "left_hand")][6:] == pytest.approx(expected, abs=1e-9)
    turned = Rotation.from_quat(kick.body_quat_wxyz[31, head], scalar_first=True)
    axes = (Rotation.from_euler("z", 0.25 - 0.4) * turned).as_matrix()
    assert sample[columns("goal_turn", "head")][:6] == pytest.approx([*axes[:, 0], *axes[:, 1]], abs=1e-9)


def test_steering_of_a_circle_is_its_speed_and_turn():
    """1 m/s forward on a circle of 2 m, 0.5 rad/s, with the sway of steps on top; away from both ends."""
    stand, times = references()["stand"], np.arange(0.0, 10.0, 0.02)
    heading = 0.5 * times
    sway = 0.2 * np.sin(2.0 * np.pi * times / 0.6)
    velocity = np.stack([np.cos(heading), np.sin(heading)], 1) + sway[:, None] * np.stack(
        [-np.sin(heading), np.cos(heading)], 1
    )
    turned = Rotation.from_rotvec(np.outer(heading + 0.1 * sway, [0.0, 0.0, 1.0]))
    circle = replace(
        stand,
        root_quat_wxyz=turned.as_quat(scalar_first=True),
        root_lin_vel_w=np.column_stack([velocity, np.zeros(len(times))]),
    )
    steering = steering_of(circle)[100:-100]
    assert steering[:, 0] == pytest.approx(np.full(300, 1.0), abs=0.02)
    assert steering[:, 1] == pytest.approx(np.zeros(300), abs=0.02)
    assert steering[:, 2] == pytest.approx(np.full(300, 0.5), abs=0.02)
    assert steering[:, 3] == pytest.approx(heading[100:-100], abs=0.02)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "full"])
def test_a_hidden_value_changes_no_bit(kind):
    """Not even one that is no number; what is shown does."""
    nothing = {
        "joint_pos_rad": "joints", "joint_vel_rad_s": "joints", "feedforward_rad": "joints", "root_lin_vel_w": "place",
        "root_ang_vel_w": "heading",
    }  # fmt: skip
    kick, usual = with_goals(references()["kick"]), seen(kick_window(kind))
    assert np.isfinite(usual).all()
    for name, part in nothing.items():
        changed = seen(kick_window(kind, **{name: np.full_like(getattr(kick, name), np.nan)}))
        if part in KINDS[kind]:
            assert np.isnan(changed).any(), name
        else:
            assert np.array_equal(changed, usual), name
    body = kick.body_pos_w.copy()
    hidden = [point for point in POINTS if point not in KINDS[kind]]
    body[:, AT[[POINTS.index(point) for point in hidden]]] = np.nan
    assert np.array_equal(seen(kick_window(kind, body_pos_w=body)), usual)
    steering = kick.steering + (1.0 if "steer" in KINDS[kind] else np.nan)
    assert np.array_equal(seen(kick_window(kind, steering=steering)), usual) == ("steer" not in KINDS[kind])


def test_nothing_shown_is_a_sample_of_zeros_but_for_what_is_measured():
    sample = seen(kick_window("none"))
    measured = columns("reference_joint_error").start
    assert not sample[measured:].any() and sample[:measured].any()


def clips(number):
    """So many robots in the first clip."""
    return torch.zeros(number, dtype=torch.long)


def test_who_is_shown_what_by_counting():
    goals = Goals(GoalSettings({"full": 0.5, "vr3": 0.3, "random": 0.2}), ["walk"], torch.Generator().manual_seed(3))
    bits = goals.draw(clips(40_000))
    shares = [(bits == bits_of(KINDS[kind])).float().mean().item() for kind in ("full", "vr3")]
    assert shares == pytest.approx([0.5, 0.3], abs=0.01)
    shown = visible(bits)
    random = shown[(bits != bits_of(KINDS["full"])) & (bits != bits_of(KINDS["vr3"]))]
    assert random.mean(dim=0).tolist() == pytest.approx([0.5] * len(PARTS), abs=0.02)
    counts = torch.bincount(random.sum(dim=1).long(), minlength=16) / len(random)
    assert counts.tolist() == pytest.approx([1 / 16] * 16, abs=0.012)  # a chance of its own for each robot
    assert shown[bits == bits_of(KINDS["vr3"])][0].tolist() == visible_in("vr3").tolist()


def test_clips_have_shares_of_their_own_by_name():
    """A name counts as a whole, and the first expression that fits; drawn anew within an episode, too."""
    of_walks = {
        "walks": KindsOf("walk_.*|stand", {"steer": 0.75, "full": 0.25}), "one": KindsOf("walk_on", {"none": 1.0}),
    }  # fmt: skip
    settings = GoalSettings({"full": 0.5, "vr3": 0.5}, of_walks, redraw_per_s=50.0)
    generator = torch.Generator().manual_seed(4)
    goals = Goals(settings, ["dance", "walk_on", "stand", "stand_up"], generator)
    clip = torch.arange(4).repeat(10_000)
    for bits in (goals.draw(clip), goals.after_tick(goals.draw(clip), clip, 0.02, generator)):
        for at, expected in enumerate([[0.5, 0.5, 0.0], [0.25, 0.0, 0.75], [0.25, 0.0, 0.75], [0.5, 0.5, 0.0]]):
            shares = [(bits[clip == at] == bits_of(KINDS[kind])).float().mean() for kind in ("full", "vr3", "steer")]
            assert [float(share) for share in shares] == pytest.approx(expected, abs=0.02)
    told = errors_by_kind(settings, bits, torch.ones(len(bits)))
    assert set(told) == {f"goal/{kind}_empbpe_mm" for kind in ("full", "vr3", "steer")}


def test_bodies_are_hidden_as_the_papers_near_poses_are():
    """By counting: how many of six bodies, and whether their place, their turn or both are shown."""
    goals = Goals(GoalSettings({"bodies": 1.0}), ["walk"], torch.Generator().manual_seed(3))
    shown = visible(goals.draw(clips(60_000))).bool()
    part = {name: shown[:, PARTS.index(name)] for name in PARTS}
    assert not part["joints"].any() and not part["steer"].any()
    assert torch.equal(part["posture"], part["heading"])
    places = torch.stack([part["place"], *(part[point] for point in POINTS)], dim=1)
    turns = torch.stack([part["posture"], *(part[f"{point}_turn"] for point in POINTS)], dim=1)
    bodies = places | turns
    # round(1 + 5 U): a tenth for 1 and 6, two tenths between; in a tenth of the draws round(1 + 2 U).
    expected = [0.9 * 0.1 + 0.1 * 0.25, 0.9 * 0.2 + 0.1 * 0.5, 0.9 * 0.2 + 0.1 * 0.25, 0.18, 0.18, 0.09]
    counts = torch.bincount(bodies.sum(dim=1), minlength=7) / len(bodies)
    assert counts.tolist() == pytest.approx([0.0, *expected], abs=0.01)
    assert bodies.float().mean(dim=0).tolist() == pytest.approx([bodies.float().mean().item()] * 6, abs=0.01)
    for kind in (places & ~turns, places & turns, turns & ~places):
        assert kind.sum() / bodies.sum() == pytest.approx(1 / 3, abs=0.01)


def test_goals_change_and_pause_within_an_episode_as_often_as_is_said():
    """Half of the robots see all, half by three points. At 50 Hz: 1 % a tick drawn anew, 2 % a gap of 2 to 6 ticks."""
    settings = GoalSettings({"full": 0.5, "vr3": 0.5}, redraw_per_s=0.5, gap_per_s=1.0, gap_s=(0.04, 0.12))
    generator = torch.Generator().manual_seed(3)
    goals = Goals(settings, ["walk"], generator)
    of = clips(4000)
    seen = [goals.draw(of)]
    for _ in range(300):
        seen.append(goals.after_tick(seen[-1], of, 0.02, generator))
    ticks = torch.stack(seen[1:])
    shown = torch.stack([visible(bits) for bits in ticks])
    in_gap = ~shown.any(dim=-1)
    parts = ticks % (1 << len(PARTS))
    changed = (parts[1:] != parts[:-1]).float().mean()
    assert changed == pytest.approx(0.01 / 2, rel=0.1)  # half of what is drawn is what was
    begun = in_gap[1:] & ~in_gap[:-1]
    assert begun.sum() / (~in_gap[:-1]).sum() == pytest.approx(0.02, rel=0.1)
    lasted = in_gap[1:].sum() / begun.sum()
    assert lasted == pytest.approx(4.0, rel=0.1)
    assert set(parts.unique().tolist()) == {bits_of(KINDS["full"]), bits_of(KINDS["vr3"])}


def test_a_gap_shows_nothing_and_then_the_same_as_before():
    settings = GoalSettings({"vr3": 1.0}, gap_per_s=50.0, gap_s=(0.1, 0.1))
    goals, generator = Goals(settings, ["walk"], torch.Generator().manual_seed(1)), torch.Generator().manual_seed(2)
    bits = goals.after_tick(goals.draw(clips(3)), clips(3), 0.02, generator)
    assert not visible(bits).any() and (bits >> len(PARTS) == 5).all()
    told = errors_by_kind(settings, bits, torch.tensor([1.0, 2.0, 3.0]))
    assert told == {"goal/gap_empbpe_mm": 2.0}
    calm = Goals(GoalSettings({"vr3": 1.0}, gap_per_s=1e-9, gap_s=(0.1, 0.1)), ["walk"], torch.Generator())
    for _ in range(5):
        assert not visible(bits).any()
        bits = calm.after_tick(bits, clips(3), 0.02, generator)
    assert visible(bits)[0].tolist() == visible_in("vr3").tolist()


def test_without_settings_everybody_is_shown_everything_and_nothing_is_drawn():
    generator = torch.Generator().manual_seed(3)
    before = generator.get_state()
    assert Goals(None, ["walk"], generator).draw(clips(3)).tolist() == [bits_of(KINDS["full"])] * 3
    assert torch.equal(generator.get_state(), before)


def test_errors_are_told_by_kind():
    kinds = {"full": 0.5, "steer": 0.4, "none": 0.0, "random": 0.1}
    bits = torch.tensor([bits_of(KINDS["full"]), bits_of(KINDS["steer"]), bits_of(KINDS["steer"]), 5])
    told = errors_by_kind(GoalSettings(kinds), bits, torch.tensor([10.0, 20.0, 40.0, 70.0]))
    assert told == {"goal/full_empbpe_mm": 10.0, "goal/steer_empbpe_mm": 30.0, "goal/random_empbpe_mm": 70.0}


@pytest.mark.parametrize(
    ("kinds", "message"),
    [({"vr4": 1.0}, "no such kind of goal"), ({"full": -1.0}, "full"), ({"full": 0.0}, "no share above 0")],
)
def test_settings_that_make_no_sense_are_refused(kinds, message):
    with pytest.raises(InputError, match=message):
        GoalSettings(kinds)
    with pytest.raises(InputError, match=message):
        KindsOf("walk", kinds)


def test_who_may_be_steered_is_known_by_the_clips_that_are_learnt_so(tmp_path):
    """The file says the range of their speeds alone, and a run without any says so before it begins."""
    for names in (["dance"], ["dance", "walk_on"]):
        for name in names:
            save_clip(swaying_clip(ROBOT, 1.0), tmp_path / f"{name}.npz")
        setup = new_setup(compose_document([f"motions={tmp_path}", "train=goals", f"run_dir={tmp_path / 'run'}"]))
        assert setup.steered == names[1:]
        assert [line[:34] for line in unsteered(setup)] == ["warning: no clip is learnt by its "] * (len(names) == 1)
    tracker = new_setup(compose_document([f"motions={tmp_path}", "train=tracker", f"run_dir={tmp_path / 'run'}"]))
    assert tracker.steered == [] == unsteered(tracker)


def test_an_expression_that_is_none_is_refused():
    with pytest.raises(InputError, match=r"clips: no regular expression, got walk_\("):
        KindsOf("walk_(", {"steer": 1.0})


def test_what_the_actor_sees_in_training_is_what_a_robot_computes():
    """Robots of three clips with goals of their own, step by step, against the deployed history and window."""
    kinds, clips = {"full": 0.3, "vr3": 0.3, "random": 0.4}, references()
    env = build_environment(
        settings(start={"first_frame": 1.0}, clips={"in_turn": True}, goals={"kinds": kinds}, **GOALS), ROBOT,
        clips, num_envs=6, seed=2, threads=2,
    )  # fmt: skip
    assert env.actor_group == GROUP
    shown = visible(env.state.goal).numpy()
    assert len(np.unique(shown, axis=0)) > 2
    tables = [with_tables(ROBOT, clip, reference_tables([GROUP])) for clip in clips.values()]

    def window(robot, tick):
        return window_at(tables[robot % 3], tick, TICKS, JOINTS, points=AT, visible=shown[robot])

    for trained, computed in observations_of_robots(env, 20, action_size=0.05, window=window):
        assert trained == pytest.approx(computed, abs=1e-4)


def test_a_teacher_follows_the_step_that_a_robot_is_in():
    """Robots in the pose of 9 ticks after their references, which turn by then; half are told no more than speeds."""
    env = build_environment(
        settings(goals={"kinds": {"full": 1.0}, "phase_s": 0.4}, teacher="tracker", **GOALS), ROBOT, references(),
        num_envs=6, seed=2, threads=2,
    )  # fmt: skip
    state, command, steer = env.state, env.command, bits_of(("steer",))
    paused = bits_of(("joints",)) + (3 << len(PARTS))
    state.goal[:] = torch.tensor([steer, 0, steer, bits_of(("steer", "left_hand")), paused, steer])
    state.clip[:], state.tick[:] = command.num_ticks.argmax(), 60
    ahead = command.table.rows(state.clip, state.tick + 9)
    state.physics.joint_pos_rad[:], state.physics.joint_vel_rad_s[:] = ahead.joint_pos_rad, ahead.joint_vel_rad_s
    rows = torch.tensor([5, 3, 1, 4])
    seen = command.window(state, rows, (0, 4))
    by_time, there = (command.table.window(state.clip[rows], torch.full((4,), tick), (0, 4)) for tick in (60, 69))
    for row, free in enumerate([True, False, True, False]):
        wanted = there if free else by_time
        assert torch.equal(seen.joint_pos_rad[row], wanted.joint_pos_rad[row])
        assert torch.equal(seen.root_height_m[row], wanted.root_height_m[row])
        assert torch.equal(seen.steer[row], by_time.steer[row])
        turns = [Rotation.from_quat(w.root_quat_wxyz[row].numpy(), scalar_first=True) for w in (seen, wanted, by_time)]
        yaw, wanted_yaw, told_yaw = (turn.as_euler("ZYX")[:, 0] for turn in turns)
        assert yaw[0] == pytest.approx(told_yaw[0], abs=1e-5)
        assert yaw[1] - yaw[0] == pytest.approx(wanted_yaw[1] - wanted_yaw[0], abs=1e-5)
        for name in ("root_lin_vel_w", "root_ang_vel_w"):
            own = [turn.inv().apply(getattr(w, name)[row]) for turn, w in zip(turns, (seen, wanted), strict=False)]
            assert own[0] == pytest.approx(own[1], abs=1e-5)
    assert there.root_quat_wxyz[0, 0] != pytest.approx(by_time.root_quat_wxyz[0, 0], abs=1e-3)
