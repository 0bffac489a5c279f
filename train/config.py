"""The training configuration: composed from configs/train by Hydra, checked whole before any simulation.

``config.environment`` is final: the sigma set is chosen, the contact mask reward removed where it is switched off.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, cast

import yaml
from hydra import compose, initialize_config_dir
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from core.errors import InputError
from core.processes import available_cores
from core.structured import at_least, parse, positive, within
from train.device import resolve_device
from train.distil.settings import DistilSettings
from train.learner.antithetic import check_pairs
from train.learner.losses import check_losses
from train.learner.precision import resolve_precision
from train.learner.settings import LearnerSettings
from train.mdp.settings import EnvironmentSettings
from train.world_model.context import MOST_DELAY_S
from train.world_model.policy import Layout
from train.world_model.settings import WorldModelSettings

CONFIG_DIR = Path(__file__).resolve().parents[1] / "configs" / "train"
_PATH_KEYS = ("motion", "motions", "robot", "run_dir", "init_from", "teacher")
MAX_SEED = 2**32 - 1
MANY_CLIPS = "tracker"
_BUDGET_KEYS = ("iterations", "minutes")


@dataclass(frozen=True)
class TrainConfig:
    """Everything a run depends on. See configs/train/config.yaml for the meaning of the keys."""

    motion: str | None
    motions: str | None
    robot: str
    seed: int
    num_envs: int
    iterations: int | None
    minutes: float | None
    checkpoint_every: int
    evaluate_every: int | None
    run_dir: str | None
    init_from: str | None
    last_mile: Literal["none", "ppo"]
    init_networks: tuple[Literal["actor", "critic", "model"], ...] | None
    sigma: Literal["adaptive", "coarse", "medium", "upperbound", "lowerbound"]
    value: Literal["vector", "scalar"]
    contact_mask: bool
    precision: Literal["bf16", "fp32"]
    device: Literal["cpu", "cuda"]
    threads: int
    prior: Literal["none", "observed"]
    environment: EnvironmentSettings
    learner: LearnerSettings | None = None
    world_model: WorldModelSettings | None = None
    teacher: str | None = None
    distil: DistilSettings | None = None

    @property
    def motion_name(self) -> str:
        """Name of what is tracked: that of the bundled clip, the file, the folder."""
        return Path(str(self.motion or self.motions)).stem

    @property
    def torch_threads(self) -> int:
        """Of each process: one where a world model learns, whose numbers must not depend on how many processes do."""
        return self.threads if self.world_model is None else 1

    def __post_init__(self) -> None:
        if self.prior == "observed":
            Layout(self.environment.actor_group(), 1)
        within("seed", self.seed, 0, MAX_SEED)
        for name in ("num_envs", "checkpoint_every", "threads"):
            at_least(name, getattr(self, name), 1)
        for name in ("iterations", "evaluate_every"):
            if getattr(self, name) is not None:
                at_least(name, getattr(self, name), 1)
        if self.minutes is not None:
            positive("minutes", self.minutes)
        if self.iterations is None and self.minutes is None:
            raise InputError("no budget", where="iterations", expected="iterations or minutes (or both)")
        if self.world_model is not None:
            self._check_world_model(self.world_model)
        self._check_teacher()
        if self.world_model is None and self.distil is None:
            self._check_learner(self.learner)

    def _check_learner(self, settings: LearnerSettings | None) -> None:
        """InputError for what does not go with PPO. A run that learns otherwise ignores these settings."""
        if settings is None:
            raise InputError("not given", where="learner", expected="settings of PPO, of a world model or of distil")
        check_losses(settings.losses)
        if settings.exploration.kind == "antithetic":
            check_pairs(settings.exploration.steps, settings.horizon, self.num_envs)
        samples = self.num_envs * settings.horizon
        if samples < 2 * settings.minibatches:
            raise InputError(
                "too few samples for the minibatches", where="num_envs", got=f"{samples} samples per iteration",
                expected=f"at least {2 * settings.minibatches}",
            )  # fmt: skip

    def _check_teacher(self) -> None:
        """InputError where distillation lacks something, or goes with something else."""
        distil = self.distil is not None
        for where, given in (("teacher", self.teacher), ("environment.teacher", self.environment.teacher)):
            if distil != (given is not None):
                expected = "a run or an actor, and its layout" if distil else "null: only distil learns from a teacher"
                raise InputError("does not fit distil", where=where, got=given, expected=expected)
        if self.distil is None:
            return
        self.distil.check(self.num_envs)
        Layout(self.environment.actor_group(), 1)
        if self.world_model is not None:
            raise InputError("not with distil", where="world_model", got="settings")

    def _check_world_model(self, settings: WorldModelSettings) -> None:
        """InputError for what does not go with learning through a world model."""
        settings.check(self.num_envs)
        Layout(self.environment.actor_group(), 1)
        if self.iterations is None:
            raise InputError("not given", where="iterations", expected="a number: the learning rate falls over them")
        may_know = self.init_from is not None and "model" in (self.init_networks or ("model",))
        settings.check_rounds(self.iterations, self.num_envs, model_known=may_know)
        if self.prior != "none":
            raise InputError("not with a world model", where="prior", got=self.prior, expected="none")
        longest_s = self.environment.randomization.delay_s[1]
        if longest_s > MOST_DELAY_S:
            raise InputError(
                "too long for a world model", where="environment.randomization.delay_s", got=longest_s,
                expected=f"at most {MOST_DELAY_S} s",
            )  # fmt: skip


def check(document: Mapping[str, Any]) -> TrainConfig:
    """Parse a resolved document (see :func:`compose_document`).

    Raises:
        InputError: an unknown key, a wrong type or an impossible value, named by its full path.
    """
    return parse(TrainConfig, document, "")


def fingerprint(document: Mapping[str, Any]) -> str:
    """SHA-256 of the resolved document, run folder left out: equal for equal trainings."""
    plain = {key: value for key, value in document.items() if key != "run_dir"}
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def compose_document(overrides: Sequence[str]) -> dict[str, Any]:
    """Compose the configuration and resolve what depends on switches and machine; plain data.

    Raises:
        InputError: an override that Hydra refuses, or a switch with an unknown value.
    """
    paths, others = _split_paths(with_preset(overrides))
    document = _compose(others) | paths
    given = [key for key in ("motion", "motions") if document.get(key) is not None]
    if not given:
        raise InputError("no motion", where="motion", expected="motion=NAME or motion=FILE", hint="e.g. motion=taichi")
    if len(given) == 2:
        raise InputError("conflicts with motion", where="motions", got=document["motions"], expected="one of the two")
    document["device"] = resolve_device(document["device"])
    document["precision"] = _resolved_precision(document["precision"])
    if document["threads"] is None:
        document["threads"] = available_cores()
    return _apply_switches(document)


def with_preset(overrides: Sequence[str]) -> list[str]:
    """The overrides, with the preset for many clips where they ask for these and name none."""
    given = {override.partition("=")[0] for override in overrides}
    return [*overrides, f"train={MANY_CLIPS}"] if "motions" in given and "train" not in given else [*overrides]


def to_yaml(document: Mapping[str, Any]) -> str:
    """The document as a file for people."""
    return yaml.safe_dump(dict(document), sort_keys=False, allow_unicode=True)


def with_budget(document: Mapping[str, Any], overrides: Sequence[str]) -> dict[str, Any]:
    """A resumed run's document with another budget. InputError for any other override."""
    changed = dict(document)
    for override in overrides:
        key, _, text = override.partition("=")
        if key not in _BUDGET_KEYS:
            raise InputError(
                "conflicts with resume", where=key, got=override, expected="resume=RUN_DIR alone, or with "
                + " or ".join(f"{name}=" for name in _BUDGET_KEYS), hint="a resumed run keeps its configuration",
            )  # fmt: skip
        try:
            changed[key] = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise InputError("unreadable value", where=key, got=text, expected="a number") from error
    return changed


def _resolved_precision(wanted: Any) -> str:
    if wanted not in ("auto", "bf16", "fp32"):
        raise InputError("unknown choice", where="precision", got=wanted, expected="one of auto, bf16, fp32")
    return resolve_precision(wanted)


def _split_paths(overrides: Sequence[str]) -> tuple[dict[str, str | None], list[str]]:
    """Keep paths, which may hold any character, away from Hydra's grammar: (path key → value, other overrides)."""
    paths: dict[str, str | None] = {}
    others = []
    for override in overrides:
        key, sign, value = override.partition("=")
        if sign and key in _PATH_KEYS:
            nothing = ("", "null", "none") if key == "init_from" else ("", "null")
            paths[key] = None if value in nothing else value
        else:
            others.append(override)
    return paths, others


def _compose(overrides: Sequence[str]) -> dict[str, Any]:
    return deepcopy(_composed(tuple(overrides)))


@cache
def _composed(overrides: tuple[str, ...]) -> dict[str, Any]:
    """What Hydra makes of them, which takes a quarter of a second: a process asks once."""
    try:
        with initialize_config_dir(str(CONFIG_DIR), version_base="1.3", job_name="train"):
            config = compose("config", overrides=list(overrides))
        return cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        preset = [override for override in overrides if override.startswith("train=")]
        raise _explained(error, {} if preset == [*overrides] else _compose(preset)) from error


def _explained(error: Exception, known: Mapping[str, Any]) -> InputError:
    """Hydra's error as one line."""
    text = " ".join(str(error).split())
    for noise in (r"In 'config': ", r" Config search path:.*", r" See https.*"):
        text = re.sub(noise, "", text)
    if match := re.search(r"full_key: (\S+)", str(error.__cause__ or error)) or re.search(r"Key '(\S+)' is not", text):
        key = match.group(1)
        names = _names_beside(key, known)
        expected, hint = (f"one of {', '.join(names)}", None) if names else (None, "the preset has no such section")
        return InputError("unknown key", where=key, expected=expected, hint=hint)
    return InputError("unusable override", where="command line", got=text, expected="KEY=VALUE")


def _names_beside(key: str, known: Mapping[str, Any]) -> list[str]:
    section: Any = known
    for part in key.split(".")[:-1]:
        section = section.get(part) if isinstance(section, Mapping) else None
    return [*section] if isinstance(section, Mapping) else []


def _apply_switches(document: dict[str, Any]) -> dict[str, Any]:
    """Settle the sigma set and the contact mask in the environment section."""
    sets, sigma, environment = document.pop("sigma_sets"), document["sigma"], document["environment"]
    choices = ["adaptive", *sets]
    if sigma not in choices:
        raise InputError("unknown choice", where="sigma", got=sigma, expected="one of " + ", ".join(choices))
    if not isinstance(environment, Mapping) or not isinstance(environment.get("rewards"), Mapping):
        return document  # refused by check()
    rewards = {name: term for name, term in environment["rewards"].items() if term is not None}
    if document["contact_mask"] is False:
        rewards.pop("contact_mask", None)
    if sigma != "adaptive":
        fixed = {name: {**rewards[name], "sigma": value} for name, value in sets[sigma].items() if name in rewards}
        rewards, environment = rewards | fixed, {**environment, "adaptive_sigma": False}
    return {**document, "environment": {**environment, "rewards": rewards}}
