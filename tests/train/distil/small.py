"""A distillation so small that an iteration takes a moment: eight robots on one short bundled clip, fp32."""

from functools import cache

import torch

from robot.robot import load_robot
from tests.train.worlds import bundled_reference
from train.config import check, compose_document
from train.distil.build import build_distil_learner
from train.lineage import find_source
from train.mdp.factory import build_environment

SMALL = [
    "motion=side_kick", "train=maskedmimic", "precision=fp32", "threads=1", "num_envs=8", "iterations=4",
    "evaluate_every=null", "distil.steps=4", "distil.capacity=64", "distil.batch=16", "distil.student.latent=6",
    "distil.student.prior_hidden=[24]", "distil.student.encoder_hidden=[24]", "distil.student.decoder_hidden=[24]",
]  # fmt: skip


def small(*overrides: str):
    """Environment and learner of SMALL with further overrides."""
    torch.set_num_threads(1)
    config, reference, robot = _config(overrides), bundled_reference("side_kick"), load_robot()
    env = build_environment(config.environment, robot, reference, num_envs=config.num_envs, seed=config.seed, threads=1)
    teacher = find_source("tracker", robot, config.environment.teacher_group(), where="teacher")
    return env, build_distil_learner(config, robot, teacher.networks["actor"])


@cache
def _config(overrides):
    return check(compose_document([*SMALL, *overrides]))
