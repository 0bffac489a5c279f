"""What the configuration says, what it refuses, and in which words."""

from dataclasses import fields, is_dataclass, replace
from typing import get_type_hints

import pytest
import yaml
from omegaconf import OmegaConf

from core.errors import InputError
from tests.shared_data import SHARED
from train.config import TrainConfig, check, compose_document, fingerprint, to_yaml, with_budget
from world.options import NO_NOISE, SensorNoise


def config(*overrides):
    return check(compose_document(["motion=taichi", "train=last_mile", *overrides]))


def changed(preset, overrides):
    """The preset's document with other values, where it does not matter what Hydra makes of them."""
    document = OmegaConf.create(compose_document(["motion=taichi", f"train={preset}"]))
    for path, value in (override.split("=", 1) for override in overrides):
        OmegaConf.update(document, path, yaml.safe_load(value), merge=False)
    return OmegaConf.to_container(document)


def rewards(*overrides):
    return config(*overrides).environment.rewards


def test_paper_preset_is_table_8_and_table_6():
    paper = config("train=paper")
    learner = paper.learner
    assert paper.num_envs == 4096
    assert (learner.horizon, learner.epochs, learner.minibatches, learner.clip) == (24, 5, 4, 0.2)
    assert (learner.gamma, learner.lam, learner.kl_target, learner.noise_std) == (0.99, 0.95, 0.01, 0.8)
    assert (learner.learning_rate, learner.losses["entropy"], learner.max_grad_norm) == (1e-3, 0.01, 1.0)
    assert learner.actor_hidden == (512, 256, 128) and learner.critic_hidden == (768, 512, 128)
    weights = {name: term.weight for name, term in paper.environment.rewards.items()}
    assert weights == {
        "joint_position": 1.0, "joint_velocity": 1.0, "body_position_lower": 1.0, "body_position_upper": 1.0,
        "body_rotation": 0.5, "body_velocity": 0.5, "body_angular_velocity": 0.5, "hands_head": 1.6, "feet": 1.0,
        "max_joint": 1.0, "contact_mask": 0.5, "joint_position_limits_indicator": -10.0,
        "joint_velocity_limits_indicator": -5.0, "torque_limits_indicator": -5.0, "slippage_squared": -1.0,
        "feet_contact_force": -0.01, "feet_air_time_indicator": -1.0, "stumble": -2.0, "torque": -1e-6,
        "action_rate": -0.02, "collision": -30.0, "termination": -200.0,
    }  # fmt: skip
    sigma = {name: term.sigma for name, term in paper.environment.rewards.items() if term.sigma}
    assert sigma == {
        "joint_position": 0.3, "joint_velocity": 30.0, "body_position_lower": 0.015, "body_position_upper": 0.015,
        "body_rotation": 0.1, "body_velocity": 1.0, "body_angular_velocity": 15.0, "hands_head": 0.015, "feet": 0.01,
        "max_joint": 1.0,
    }  # fmt: skip
    assert paper.prior == "none" and paper.environment.sensing.noise == NO_NOISE


RELEASED = {  # name in the released file → name here
    "teleop_contact_mask": "contact_mask", "teleop_max_joint_position": "max_joint", "teleop_vr_3point": "hands_head",
    "teleop_body_position_feet": "feet", "teleop_body_rotation_extend": "body_rotation",
    "teleop_body_ang_velocity_extend": "body_angular_velocity", "teleop_body_velocity_extend": "body_velocity",
    "teleop_joint_position": "joint_position", "teleop_joint_velocity": "joint_velocity", "penalty_torques": "torque",
    "penalty_action_rate": "action_rate", "feet_air_time": "feet_air_time", "penalty_stumble": "stumble",
    "penalty_feet_contact_forces": "feet_contact_force", "penalty_slippage": "slippage",
    "limits_dof_pos": "joint_position_limits", "limits_dof_vel": "joint_velocity_limits",
    "limits_torque": "torque_limits", "termination": "termination", "collision": "collision",
}  # fmt: skip
NOISY = ("dof_pos", "dof_vel", "base_ang_vel", "projected_gravity")


def test_release_preset_is_the_authors_file():
    path = SHARED / "pbhc" / "actor_horse_stance_pose" / "config.yaml"
    if not path.exists():
        pytest.skip(f"the authors' configuration is not there: {path}")
    released = yaml.safe_load(path.read_text())
    ours = config("train=pbhc_release")
    scales = {name: value for name, value in released["rewards"]["reward_scales"].items() if value}
    scales.pop("teleop_body_position_extend")
    weights = {name: term.weight for name, term in ours.environment.rewards.items()}
    assert (weights.pop("body_position_lower"), weights.pop("body_position_upper")) == (1.0, 1.0)
    assert weights == {RELEASED[name]: value for name, value in scales.items()}
    noise = released["obs"]["noise_scales"]
    assert ours.environment.sensing.noise == SensorNoise(*(noise[name] for name in NOISY))
    algorithm = released["algo"]["config"]
    assert ours.learner.losses["entropy"] == algorithm["entropy_coef"]
    assert ours.learner.noise_std == algorithm["init_noise_std"]
    assert ours.environment.penalty_scale.factor == released["rewards"]["reward_penalty_degree"]


def test_presets_differ_in_what_is_randomised_as_the_paper_and_the_file_do():
    paper, release = (config(f"train={name}").environment.randomization for name in ("paper", "pbhc_release"))
    assert (paper.inertia_of, release.inertia_of) == ("ankles", "all")
    assert not paper.delay_whole_steps and release.delay_whole_steps


PRESETS = [
    "clip", "tracker", "last_mile", "goals", "maskedmimic", "maskedmimic_paper", "window", "paper", "pbhc_release",
]  # fmt: skip


def unnamed(kind, section, where):
    """Fields that the composed document does not name: they could not be overridden on the command line."""
    missing = [f"{where}.{f.name}" for f in fields(kind) if f.name not in section]
    hints = get_type_hints(kind)
    nested = [f.name for f in fields(kind) if is_dataclass(hints[f.name]) and f.name in section]
    return missing + [path for name in nested for path in unnamed(hints[name], section[name], f"{where}.{name}")]


@pytest.mark.parametrize("preset", PRESETS)
def test_every_number_stands_in_the_files(preset):
    document = compose_document(["motion=taichi", f"train={preset}"])
    document["environment"]["rewards"] = {}
    assert unnamed(TrainConfig, document, "") == []


def test_sigma_sets_are_table_10():
    names = ("joint_position", "body_position_lower", "body_position_upper", "body_rotation", "hands_head", "max_joint")
    expected = {
        "coarse": (0.3, 0.015, 0.015, 0.1, 0.015, 1.0),
        "medium": (0.1, 0.005, 0.005, 0.03, 0.005, 0.3),
        "upperbound": (0.08, 0.002, 0.002, 0.4, 0.003, 0.5),
        "lowerbound": (0.02, 0.0003, 0.0003, 0.02, 0.0003, 0.25),
    }
    for name, values in expected.items():
        fixed = config(f"sigma={name}")
        assert tuple(fixed.environment.rewards[term].sigma for term in names) == values
        assert not fixed.environment.adaptive_sigma
        assert fixed.environment.rewards["feet"].weight == rewards()["feet"].weight
    assert config().environment.adaptive_sigma


def test_contact_mask_can_be_switched_off():
    assert "contact_mask" in rewards() and "contact_mask" not in rewards("contact_mask=false")


@pytest.mark.parametrize("preset", PRESETS)
def test_resolved_document_means_the_same_again(preset):
    document = compose_document(["motion=taichi", f"train={preset}", "sigma=medium"])
    assert document["precision"] in ("bf16", "fp32") and document["threads"] >= 1
    assert check(document) == check(dict(document))
    assert check(yaml.safe_load(to_yaml(document))) == check(document)


@pytest.mark.parametrize("preset", ["tracker", "maskedmimic"])
def test_a_run_that_has_ppos_settings_besides_is_still_one(preset):
    """Documents of older runs do."""
    document, ppo = (compose_document(["motion=taichi", f"train={name}"]) for name in (preset, "window"))
    assert document["learner"] is None
    assert replace(check({**document, "learner": ppo["learner"]}), learner=None) == check(document)


def test_fingerprint_follows_the_training_not_the_folder():
    first, moved, other = (compose_document(["motion=taichi", o]) for o in ("seed=1", "run_dir=elsewhere", "seed=2"))
    assert fingerprint(first) == fingerprint(moved) != fingerprint(other)


def test_paths_may_hold_any_character():
    strange = r"/tmp/a b=c'd,[e]{f}\g$h.npz"
    assert check(compose_document([f"motion={strange}"])).motion == strange


REFUSED = [
    ("environment.events.push.params.velocity=1", "environment.events.push.params.velocity"),
    ("foo=1", "foo: unknown key, expected one of motion, motions, robot, seed"),
    ("learner.horizn=1", "learner.horizn: unknown key, expected one of horizon, epochs"),
    ("+learner.horizn=1", "did you mean horizon?"),
    ("environment.rewards.feat.weight=1", "environment.rewards.feat: unknown key"),
    ("+environment.rewards.smile={weight: 1.0}", "environment.rewards.smile: unknown reward term"),
    ("num_envs=1.5", "num_envs: wrong type, got 1.5, expected a whole number"),
    ("num_envs=many", "num_envs: wrong type, got 'many'"),
    ("num_envs=1,2", "unusable override"),
    ("iterations=null", "iterations: no budget"),
    ("sigma=fine", "sigma: unknown choice, got fine, expected one of adaptive, coarse, medium, upperbound, lowerbound"),
    ("value=matrix", "value: unknown choice, got matrix"),
    ("precision=int8", "precision: unknown choice"),
    ("contact_mask=maybe", "contact_mask: wrong type"),
    ("train=thesis", "Could not find 'train/thesis'"),
    ("learner.actor_hidden=[64,0]", r"learner.actor_hidden\[1\]: too small"),
    ("environment.rewards.feet.weight=nan", "environment.rewards.feet.weight: not finite"),
    ("~learner", "learner: not given"),
    ("nonsense", "unusable override"),
    ("=3", "unusable override"),
    ("motion=null", "motion: no motion"),
]


REFUSED_VALUES = [
    ("num_envs=0", "num_envs: too small, got 0, expected at least 1"),
    ("num_envs=-4", "num_envs: too small, got -4"),
    ("iterations=0", "iterations: too small"),
    ("minutes=0", "minutes: not positive"),
    ("checkpoint_every=0", "checkpoint_every: too small"),
    ("seed=-1", "seed: out of range"),
    ("seed=9999999999999999999", "seed: out of range"),
    ("threads=0", "threads: too small"),
    ("learner.clip=0", "learner.clip: not positive"),
    ("learner.gamma=1.1", "learner.gamma: out of range"),
    ("learner.actor_hidden=[]", "learner.actor_hidden"),
    ("learner.learning_rate=1", "learner.learning_rate: out of range"),
    ("environment.rewards.feet.sigma=-1", "environment.rewards.feet.sigma"),
    ("environment.randomization.friction=[2,1]", "randomization.friction: not a range"),
    ("environment.randomization.friction=[0,1]", "randomization.friction: too small"),
    ("environment.randomization.mass_scale=[-1,1]", "randomization.mass_scale: not a range"),
    ("environment.randomization.nominal_share=1.1", "randomization.nominal_share: out of range"),
    ("environment.randomization.com_z_m=-1", "randomization.com_z_m: too small"),
    ("environment.events.push.interval_s=[0,1]", r"environment.events.push.interval_s\[0\]: not positive"),
    ("environment.start.by_failure=0.95", "environment.start.by_failure: out of range"),
    ("environment.start.joint_noise_rad=-1", "environment.start.joint_noise_rad: too small"),
    ("environment.termination.max_episode_s=0", "environment.termination.max_episode_s: not positive"),
    ("environment.sensing.noise.joint_pos_rad=-1", "environment.sensing.noise.joint_pos_rad: too small"),
    ("environment.error_limit_m.start=-1", "environment.error_limit_m.start: too small"),
    ("environment.penalty_scale.start=9", "environment.penalty_scale.start: out of range"),
    ("environment.sigma_alpha=2", "environment.sigma_alpha: out of range"),
    ("environment=null", "environment: wrong type"),
    ("environment.rewards=3", "environment.rewards: wrong type"),
    ("learner=3", "learner: wrong type"),
    ("prior=magic", "prior: unknown choice, got magic, expected one of none, observed"),
]


REFUSED_WITH_A_WORLD_MODEL = [
    (["iterations=null", "minutes=5"], "iterations: not given"),
    (["world_model=null"], "learner: not given, expected settings of PPO, of a world model or of distil"),
    (["environment.observations=pbhc"], "environment.observations: missing term, expected reference_joint_pos"),
    (["environment.randomization.delay_s=[0.0,0.05]"], "environment.randomization.delay_s: too long"),
    (["world_model.cost.beauty=1.0"], "world_model.cost.beauty: unknown cost term"),
    (["world_model.imagination.horizon=7"], "world_model.imagination.horizon: odd"),
    (["world_model.imagination.batch=0"], "world_model.imagination.batch: too small, got 0, expected at least 1"),
    (["world_model.imagination.noise_rad=-1"], "world_model.imagination.noise_rad: too small"),
    (["world_model.imagination.noise_memory=1.5"], "world_model.imagination.noise_memory: out of range"),
    (["world_model.imagination.lost.tilt=-1"], "world_model.imagination.lost.tilt: not positive"),
    (["world_model.fitting.warm_up_steps=1000"], "world_model.fitting.warm_up_steps: too few steps for the windows"),
    (["world_model.policy.hidden=[]"], "world_model.policy.hidden: unusable layers"),
    # 196 steps of 512 robots take 49 iterations, and 1040 updates of the model, 20 each, begin in the last of them.
    (["iterations=101"], "iterations: the policy would learn nothing, got 101, expected 102 or more with 512"),
    (["init_from=tracker", "iterations=49"], "iterations: the policy would learn nothing, got 49, expected 50 or"),
    (["init_from=tracker", "init_networks=[actor]", "iterations=101"], "iterations: the policy would learn nothing"),
    (
        ["num_envs=600", "world_model.capacity=100100", "world_model.starts.newest_steps=50000"],
        "world_model.capacity: fewer steps than the first update waits for, got 99600 steps of 600 robots",
    ),
]


REFUSED_WITH_DISTIL = [
    (["teacher=null"], "teacher: does not fit distil, expected a run or an actor, and its layout"),
    (["environment.teacher=null"], "environment.teacher: does not fit distil"),
    (["distil=null"], "teacher: does not fit distil, got tracker, expected null"),
    (["environment.teacher=trackr"], "environment.teacher: unknown layout, got trackr"),
    (["distil.capacity=1000"], "distil.capacity: no whole steps, got 1000, expected a multiple of 512 robots"),
    (["distil.batch=5000"], "distil.batch: too many, got 5000, expected at most an iteration's samples, 2048"),
    (["distil.acts.nobody={first: 1.0}"], "distil.acts.nobody: nobody of this name"),
    (
        [f"distil.acts.{who}.{at}=0" for who in ("encoder", "prior") for at in ("first", "last")],
        "distil.acts: nothing above 0, got iteration 800",
    ),
    (["distil.losses.beauty={first: 1.0}"], "distil.losses.beauty: unknown loss"),
    (["distil.losses.kl.end=5"], "distil.losses.kl.end: before begin, got 5, expected 300 or later"),
    (["distil.student.decoder_hidden=[]"], "distil.student.decoder_hidden: unusable layers"),
    (["distil.noise=loud"], "distil.noise: unknown choice, got loud"),
    (["environment.observations=pbhc", "prior=none"], "environment.observations: missing term"),
]


@pytest.mark.parametrize(("overrides", "message"), REFUSED_WITH_DISTIL)
def test_refused_with_distillation(overrides, message):
    with pytest.raises(InputError) as caught:
        check(changed("maskedmimic", overrides))
    assert message in str(caught.value)


def test_the_papers_numbers_of_distillation():
    """MaskedMimic's schedule of the KL, minibatch, rate, horizon, latent and masks; 2 % and 1 % a frame at 30 Hz."""
    paper = config("train=maskedmimic_paper")
    distil, goals = paper.distil, paper.environment.goals
    kl = distil.losses["kl"]
    assert (kl.first, kl.last, kl.begin, kl.end) == (1e-4, 1e-2, 3000, 9000)
    assert (paper.num_envs, distil.steps, distil.batch, distil.student.latent) == (16384, 32, 8192, 64)
    assert distil.updates * distil.batch == distil.capacity == 524_288  # each sample once
    assert distil.learning_rate.at(0) == distil.learning_rate.at(10_000) == 2e-5
    for iteration in (0, 300, 10_000):
        assert {name: now for name, ramp in distil.acts.items() if (now := ramp.at(iteration))} == {"encoder": 1.0}
    assert {name for name, ramp in distil.losses.items() if ramp.at(10_000)} == {"action", "kl"}
    assert (goals.redraw_per_s / 30, goals.gap_per_s / 30) == pytest.approx((0.02, 0.01))
    assert tuple(30 * seconds for seconds in goals.gap_s) == pytest.approx((1.0, 9.0), abs=0.01)
    assert {kind: share for kind, share in goals.of("walk_forward").items() if share} == {"bodies": 1.0}
    assert goals.phase_s == 0.0


@pytest.mark.parametrize(("preset", "threads"), [("clip", 1), ("last_mile", 3)])
def test_torch_has_one_thread_where_a_world_model_learns(preset, threads):
    """In one process as in two: how many threads add numbers up changes them."""
    assert config(f"train={preset}", "threads=3").torch_threads == threads


@pytest.mark.parametrize(("overrides", "message"), REFUSED_WITH_A_WORLD_MODEL)
def test_refused_with_a_world_model(overrides, message):
    with pytest.raises(InputError) as caught:
        check(changed("tracker", overrides))
    assert message in str(caught.value)


@pytest.mark.parametrize(("override", "message"), REFUSED, ids=[override for override, _ in REFUSED])
def test_refused_in_one_line(override, message):
    with pytest.raises(InputError, match=message) as caught:
        config(override)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("override", "message"), REFUSED_VALUES, ids=[override for override, _ in REFUSED_VALUES])
def test_refused_values(override, message):
    with pytest.raises(InputError, match=message) as caught:
        check(changed("last_mile", [override]))
    assert "\n" not in str(caught.value)


def test_resume_takes_a_budget_and_nothing_else():
    document = compose_document(["motion=taichi", "iterations=5"])
    assert with_budget(document, ["iterations=9", "minutes=2"]) == {**document, "iterations": 9, "minutes": 2}
    for override in ("seed=2", "motion=stand", "train=paper", "num_envs=3"):
        with pytest.raises(InputError, match="conflicts with resume"):
            with_budget(document, [override])
    with pytest.raises(InputError, match="iterations: wrong type"):
        check(with_budget(document, ["iterations=many"]))
