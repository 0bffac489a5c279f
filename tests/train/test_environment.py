"""The tracking environment: layout, timing, resets, curricula, resuming."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from core.errors import InputError
from motion.feet import ground_lift_m
from motion.metrics import empbae_mm
from policy.layouts import pbhc_actor_group
from policy.observation import sample_terms
from tests.train.worlds import CONSTANT, NOISE, g1, observations_of_robots, settings, small_env, swaying_reference
from train.interface import width
from train.mdp.curriculum import Curriculum, EpisodeAverage
from train.mdp.settings import CurriculumSettings
from train.mdp.tick import ReferenceTable
from train.nan_guard import NonFiniteError, check_step
from train.simulation.domain import DomainRanges

FIRST_FRAME = {"first_frame": 1.0}


def hold(env) -> torch.Tensor:
    return torch.zeros(env.num_envs, env.num_actions)


def test_observation_sizes_are_those_of_the_paper():
    env = small_env()
    assert (width(env.layout["actor"]), width(env.layout["critic"]), env.num_actions) == (380, 630, 23)


def test_an_episode_ends_with_the_clip_and_is_not_a_failure():
    env = small_env(start=FIRST_FRAME)
    for _ in range(49):
        result = env.step(hold(env))
        assert not result.terminated.any() and not result.timed_out.any()
    result = env.step(hold(env))
    assert result.timed_out.all() and not result.terminated.any()
    assert result.final_critic_obs.shape == (env.num_envs, 630)
    assert env.state.tick.tolist() == [0] * env.num_envs


def test_after_the_motion_its_last_pose_is_held():
    env = small_env(start=FIRST_FRAME, termination={"hold_s": 0.1})
    results = [env.step(hold(env)) for _ in range(55)]
    assert [bool(result.timed_out.all()) for result in results] == [False] * 54 + [True]
    assert results[52].observations["actor"][0, env.layout["actor"]["ref_motion_phase[0]"]].tolist() == [1.0]


def test_a_maximal_length_is_a_time_out():
    env = small_env(start=FIRST_FRAME, termination={"max_episode_s": 0.1})
    results = [env.step(hold(env)) for _ in range(5)]
    assert [bool(r.timed_out.all()) for r in results] == [False] * 4 + [True]
    assert results[-1].log["episode_length_ratio"] == pytest.approx(1.0 - 0.99**4)  # four that went as far as they may


def test_a_point_too_far_from_its_reference_fails():
    limit = CONSTANT | {"start": 0.25, "easy": 0.25, "hard": 0.25}
    env = small_env(start=FIRST_FRAME, error_limit_m=limit)
    action = hold(env)
    action[0, 15] = 8.0  # one arm raised by 2 rad, in the first environment only
    failed = torch.zeros(env.num_envs, dtype=torch.bool)
    for _ in range(15):
        failed |= env.step(action).terminated
    assert failed.tolist() == [True] + [False] * (env.num_envs - 1)


def test_rewards_are_weight_times_term_times_period():
    env = small_env(start=FIRST_FRAME, penalty_scale=CONSTANT | {"start": 0.5, "easy": 0.5, "hard": 0.5})
    action = hold(env)
    action[1] = 0.1
    rewards = dict(zip(env.reward_names, env.step(action).rewards.T, strict=True))
    assert rewards["contact_mask"].tolist() == pytest.approx([0.5 * 0.02] * env.num_envs)
    # 23 changes of 0.1: -0.5 * 0.23 * 0.02, halved by the curriculum
    assert rewards["action_rate"].tolist() == pytest.approx([0.0, -0.5 * 0.23 * 0.02 * 0.5, 0.0, 0.0], abs=1e-9)
    assert 0.9 * 0.02 < rewards["joint_position"].min() <= 0.02
    assert rewards["termination"].tolist() == [0.0] * env.num_envs


def test_the_rewarded_acceleration_error_is_the_judged_one_from_the_first_step_on():
    """Second differences as in motion.metrics; before an episode's first frame the robot came at its velocity."""
    env = small_env(
        rewards={"body_acceleration": {"weight": 1.0, "sigma": 0.02}},
        adaptive_sigma=False,
        termination={"max_episode_s": 0.12},
        start={"joint_noise_rad": 0.05, "velocity_noise": 0.3},
    )
    reference = swaying_reference(g1())
    generator = torch.Generator().manual_seed(2)
    frames: list[tuple[np.ndarray, np.ndarray]] = [(np.empty(0), np.empty(0))] * env.num_envs  # actual, wanted
    judged = 0
    for _ in range(20):
        for robot in (env.state.episode_steps == 0).nonzero()[:, 0].tolist():
            pos, velocity = (getattr(env.state.bodies, name)[robot].numpy() for name in ("pos_w", "lin_vel_w"))
            wanted = reference.body_pos_w[env.state.tick[robot]]
            wanted_velocity = reference.body_lin_vel_w[env.state.tick[robot]]
            frames[robot] = np.stack([pos - 0.02 * velocity, pos]), np.stack([wanted - 0.02 * wanted_velocity, wanted])
        result = env.step(0.3 * torch.randn(env.num_envs, 23, generator=generator))
        for robot in (
            (env.state.episode_steps > 0).nonzero()[:, 0].tolist()
        ):  # the others stand at their next start already
            actual, wanted = frames[robot]
            actual = np.stack([*actual[-2:], env.state.bodies.pos_w[robot].numpy()])
            wanted = np.stack([*wanted[-2:], reference.body_pos_w[env.state.tick[robot]]])
            frames[robot] = actual, wanted
            error_m = empbae_mm(actual, wanted)[0] / 1000
            assert result.rewards[robot, 0].item() == pytest.approx(0.02 * np.exp(-error_m / 0.02), rel=1e-3)
            judged += error_m > 0.001
    assert judged > 40


def test_a_contact_that_flickers_for_a_tick_is_no_step(monkeypatch):
    """One foot, tick by tick; time in the air counts from the second tick without a contact, and ends at a contact."""
    touches = [1, 0, 1, 0, 0, 0, 0, 1, 0]
    air_s = [0.00, 0.00, 0.00, 0.00, 0.02, 0.04, 0.06, 0.00, 0.00]
    new = [0, 0, 0, 0, 0, 0, 0, 1, 0]  # not the first: an episode begins with no time in the air
    env = small_env(num_envs=1, seconds=2.0, start=FIRST_FRAME)
    state, forces, seen = env.simulator.state, iter(touches), []

    def with_forces():
        force = torch.tensor([[[0.0, 0.0, 100.0 * next(forces)], [0.0, 0.0, 100.0]]])
        return replace(state(), foot_force_w=force)

    keep = env._keep
    monkeypatch.setattr(env.simulator, "state", with_forces)
    monkeypatch.setattr(env, "_keep", lambda t: (seen.append(t), keep(t)))
    for wanted_s in air_s:
        env.step(hold(env))
        assert env.state.air_time_s[0, 0].item() == pytest.approx(wanted_s, abs=1e-6)
    assert [int(t.first_contact[0, 0]) for t in seen] == new
    assert [bool(t.contact[0, 0]) for t in seen] == [bool(touch) for touch in touches]


def test_starts_lie_on_the_reference_with_its_velocities():
    env = small_env(num_envs=64)
    reference = swaying_reference(g1())
    ticks = env.state.start_tick.numpy()
    assert len(np.unique(ticks)) > 10 and ticks.max() < 50
    state = env.simulator.state()
    assert state.joint_pos_rad.numpy() == pytest.approx(reference.joint_pos_rad[ticks], abs=1e-6)
    moving = ticks > 0
    assert state.joint_vel_rad_s.numpy()[moving] == pytest.approx(reference.joint_vel_rad_s[ticks][moving], abs=1e-5)
    assert not state.joint_vel_rad_s.numpy()[~moving].any()


def test_start_states_are_lifted_until_the_lowest_sole_corner_touches():
    robot = g1()
    reference = swaying_reference(robot)
    lift = ground_lift_m(robot, reference)
    sole = min(corner[2] for corner in robot.sole_points_m["left_ankle_roll_link"])
    foot = reference.body_pos_w[:, robot.tracked_index(["left_ankle_roll_link"])[0], 2]
    assert foot + sole + lift == pytest.approx(np.zeros(len(foot)), abs=1e-9)


def test_actor_observations_equal_those_of_the_robot():
    """What training feeds the network is, from the first tick on, what deployment's history gives."""
    env = small_env(num_envs=2, start=FIRST_FRAME)
    assert env.actor_group == pbhc_actor_group()
    for trained, computed in observations_of_robots(env, 12, action_size=0.1):
        assert trained == pytest.approx(computed, abs=2e-5)


def test_noise_has_the_configured_width_and_grows_with_the_randomisation():
    sensing = {"noise": NOISE | {"gravity": 0.02}}
    env = small_env(num_envs=512, start=FIRST_FRAME, sensing=sensing)
    default, seen = torch.tensor(g1().default_pos_rad), env.observations.groups(env.state.actor_history)["actor"]
    for values, half_width in (
        (seen[:, -4:-2], 0.02),
        (seen[:, 23:26] / 0.25, 0.3),
        (seen[:, 26:49] + default - env.state.physics.joint_pos_rad, 0.02),
        (seen[:, 49:72] / 0.05, 1.0),
    ):
        assert 0.97 * half_width < values.abs().max() < 1.025 * half_width  # a tilted vector is divided by its length
        assert float(values.std()) == pytest.approx(2.0 * half_width / np.sqrt(12), rel=0.05)
    assert (seen[:, -4:-1].norm(dim=1) - 1.0).abs().max() < 1e-6
    quiet = CONSTANT | {"start": 0.0, "easy": 0.0, "hard": 0.0}
    env = small_env(start=FIRST_FRAME, sensing=sensing, randomization_scale=quiet)
    assert (
        env.observations.groups(env.state.actor_history)["actor"][:, -4:-1].tolist()
        == [pytest.approx([0.0, 0.0, -1.0], abs=1e-6)] * 4
    )


def test_a_resumed_environment_continues_to_the_same_numbers():
    ranges = {"friction": [0.6, 1.1], "torque_noise": 0.05, "torque_offset": 0.05, "delay_s": [0.0, 0.04]}
    changes = {
        "randomization": ranges,
        "sensing": {"noise": NOISE},
        "start": {"first_frame": 0.3, "by_failure": 0.3, "joint_noise_rad": 0.02},
        "events": {"push": {"interval_s": [0.1, 0.2], "params": {"velocity_m_s": 0.2}}},
    }
    first, second = small_env(seconds=0.4, **changes), small_env(seconds=0.4, seed=9, **changes)
    generator = torch.Generator().manual_seed(5)
    actions = 0.2 * torch.randn(60, 4, 23, generator=generator)
    for action in actions[:25]:
        first.step(action)
    second.load_state_dict(first.state_dict())
    for action in actions[25:]:
        a, b = first.step(action), second.step(action)
        assert torch.equal(a.rewards, b.rewards)
        assert torch.equal(a.observations["actor"], b.observations["actor"])
        assert torch.equal(a.observations["critic"], b.observations["critic"])
        assert a.log == b.log


def test_several_clips_share_one_table():
    robot = g1()
    short, long = swaying_reference(robot, 0.4), swaying_reference(robot, 1.0)
    table = ReferenceTable([short, long], [ground_lift_m(robot, clip) for clip in (short, long)], "cpu")
    rows = table.rows(torch.tensor([0, 1, 0]), torch.tensor([3, 50, 99]))
    expected = [short.joint_pos_rad[3], long.joint_pos_rad[50], short.joint_pos_rad[20]]
    assert rows.joint_pos_rad.numpy() == pytest.approx(np.array(expected), abs=1e-6)
    assert rows.phase.flatten().tolist() == pytest.approx([0.15, 1.0, 1.0])


def test_beyond_the_end_a_table_gives_the_last_pose_at_rest():
    robot = g1()
    references = [swaying_reference(robot, 0.41), swaying_reference(robot, 1.0)]  # the first ends while it moves
    table = ReferenceTable(references, [ground_lift_m(robot, clip) for clip in references], "cpu")
    last, beyond = (
        table.rows(torch.tensor([0, 0]), torch.tensor([20, 30])),
        table.rows(torch.tensor([0]), torch.tensor([21])),
    )
    assert last.joint_vel_rad_s[0].abs().max() > 0.1
    for name, values in vars(beyond).items():
        expected = torch.zeros_like(values) if name.endswith(("_vel_w", "_vel_rad_s")) else getattr(last, name)[:1]
        torch.testing.assert_close(values, expected)
        torch.testing.assert_close(getattr(last, name)[1:], expected)


def test_a_curriculum_moves_by_its_driver_and_stops_at_its_bounds():
    limit = Curriculum(CurriculumSettings(1.5, 2.0, 0.3, 0.1, "episode_length", 42.0, 40.0))
    limit.update(episode_length=41.0, survival=0.0)
    assert limit.value == 1.5
    limit.update(episode_length=43.0, survival=0.0)
    assert limit.value == pytest.approx(1.5 / 1.1)
    limit.update(episode_length=39.0, survival=0.0)
    limit.update(episode_length=39.0, survival=0.0)
    assert limit.value == pytest.approx(1.65)
    for _ in range(100):
        limit.update(episode_length=50.0, survival=0.0)
    assert limit.value == 0.3


def test_episode_averages_start_at_the_first_episodes():
    average = EpisodeAverage()
    average.update(torch.tensor([10, 30]), torch.tensor([True, False]), window=100)
    assert (average.length, average.survival) == (20.0, 0.5)
    average.update(torch.tensor([]), torch.tensor([]), window=100)
    average.update(torch.tensor([50, 50]), torch.tensor([True, True]), window=4)
    assert (average.length, average.survival) == (35.0, 0.75)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"rewards": {"no_such_term": {"weight": 1.0}}}, "unknown reward term"),
        ({"rewards": {"joint_position": {"weight": 1.0}}}, "needs a sigma"),
        ({"rewards": {}}, "no reward term"),
        ({"rewards": {"contact_mask": {"weight": 1.0}}}, "no tracking term"),
        ({"sensing": {"noise": {"dof_pos": 0.1}}}, "sensing.noise"),
        ({"randomization_scale": CONSTANT | {"hard": 2.0}}, "randomization_scale.hard: out of range"),
        ({"penalty_scale": CONSTANT | {"start": 0.0, "easy": 0.0, "factor": 1e-3}}, "penalty_scale.start: not pos"),
        ({"simulation": {"substeps": 0}}, "at least 1"),
        ({"randomization": {"frictoin": [1, 1]}}, "unknown key"),
        ({"rewards": {"torque": {"weight": 1.0, "params": {"limit": 1.0}}}}, "torque.params.limit: unknown parameter"),
        ({"termination": {"terms": {"tilt": {}}}}, "termination.terms.tilt.limit: missing parameter"),
        ({"termination": {"terms": {"tipped": {}}}}, "termination.terms.tipped: unknown termination"),
        ({"events": {"push": {"interval_s": [0.0, 1.0], "params": {"velocity_m_s": 0.1}}}}, "interval_s.0.: not pos"),
        ({"events": {"shove": {"interval_s": [1.0, 2.0]}}}, "events.shove: unknown event"),
        ({"critic": ["mass"]}, "environment.critic.mass: unknown critic term"),
        ({"observations": "none_such"}, "environment.observations: unknown layout"),
        ({"observations": [{"term": "dof_poss"}]}, "environment.observations.*unknown observation term"),
        ({"penalty_scale": CONSTANT | {"driver": "hope"}}, "penalty_scale.driver: unknown choice.*survival"),
    ],
)
def test_bad_settings_are_refused_by_name(changes, text):
    with pytest.raises(InputError, match=text):
        settings(**changes)


def test_nominal_ranges_change_nothing():
    assert replace(DomainRanges()) == DomainRanges()
    env = small_env()
    assert env.simulator.domain.friction.tolist() == [1.0] * env.num_envs


@pytest.mark.parametrize("velocity", [float("nan"), float("inf"), 1e12])
def test_one_robot_whose_physics_diverges_has_failed_and_the_others_go_on(velocity):
    env, undisturbed = small_env(), small_env()
    zeros = torch.zeros(env.num_envs, env.num_actions)
    env.simulator.push(torch.tensor([2]), torch.tensor([[velocity, 0.0]]))
    result, usual = env.step(zeros), undisturbed.step(zeros)
    assert result.terminated.tolist() == [i == 2 for i in range(env.num_envs)]
    assert result.log["diverged"] == pytest.approx(1 / env.num_envs) and usual.log["diverged"] == 0.0
    others = [i for i in range(env.num_envs) if i != 2]
    assert torch.equal(result.rewards[others], usual.rewards[others])
    assert result.rewards[2, env.reward_names.index("termination")] < 0.0
    for _ in range(3):
        result = env.step(zeros)
        check_step(result)
        assert not result.terminated.any() and result.log["diverged"] == 0.0


def test_physics_that_diverges_for_many_is_named_and_not_hidden_by_a_reset():
    env = small_env()
    env.simulator.push(torch.tensor([0, 2]), torch.full((2, 2), float("nan")))
    with pytest.raises(NonFiniteError, match=r"physics .*: NaN or infinity in environment 0, 2$"):
        env.step(torch.zeros(env.num_envs, env.num_actions))


def test_a_loaded_state_is_out_of_reach_of_later_resets():
    env = small_env(start={"joint_noise_rad": 0.1})
    state = env.state_dict()
    before = {name: value.clone() for name, value in state["state"].items()}
    env.load_state_dict(state)
    env.reset()
    assert all(torch.equal(value, before[name]) for name, value in state["state"].items())


def test_the_critic_sees_numbers_within_the_clip_too():
    env = small_env()
    result = env.step(torch.full((env.num_envs, env.num_actions), 1e3))
    assert float(result.observations["critic"].max()) == 100.0


def test_what_looks_ahead_is_sampled_once_a_step_and_kept_of_the_present_tick_alone(monkeypatch):
    """The critic's exact terms are the robot's own; older ticks of what looks ahead are in no observation."""
    env, sampled = small_env(observations="tracker", critic=["history"]), []

    def sample(terms, seen):
        sampled.append(any(entry.ticks for entry in terms))
        return sample_terms(terms, seen)

    monkeypatch.setattr("train.mdp.observations.sample_terms", sample)
    env.step(hold(env))
    assert sorted(sampled) == [False, True]
    ahead = env.observations.ahead(torch.arange(env.state.actor_history.shape[2])[None])[0]
    assert env.state.actor_history[:, 0, ahead].any() and not env.state.actor_history[:, 1:, ahead].any()
