"""Judges an actor while it trains: noisy starts at the first frame, some nominal, most of them randomised."""

import math
from collections.abc import Mapping
from dataclasses import replace

import torch

from motion.reference import Reference
from robot.robot import Robot
from train.interface import Policy
from train.mdp.factory import build_environment
from train.mdp.settings import (
    ClipSettings,
    CurriculumSettings,
    EnvironmentSettings,
    StartSettings,
    TerminationSettings,
)
from train.mdp.tracking import TrackingEnv

# Who falls differs by chance, how far off one is hardly. Of several clips there are a little more: of each the same.
STARTS = {"nominal": 24, "randomized": 96}
START_NOISE_RAD = 0.02
FALL_HEIGHT_SHARE = 0.4
FALL_COST = 1000.0
ERROR_WEIGHT = 0.1


class NoisyStartEvaluator:
    """Plays the whole clip from noisy starts, without training's distance limit; of several clips each in turn.

    The score is the body error (Empbpe, mm) plus a tenth of the global one, plus 1000 times the share of starts that
    fall, averaged over nominal starts and starts with full randomisation and observation noise. Its error is what
    chance alone makes of the falls (standard error of a binomial share).

    Args:
        settings: the training environment's; its randomisation and noise are used at full size.
        robot: who tracks.
        references: what is tracked, by name.
        seed: of every evaluation, so that actors meet the same conditions.
        threads: worker threads of the physics.
    """

    def __init__(
        self,
        settings: EnvironmentSettings,
        robot: Robot,
        references: Mapping[str, Reference],
        *,
        seed: int,
        threads: int,
    ) -> None:
        self._references, self._robot, self._seed, self._threads = references, robot, seed, threads
        self._settings = whole_clip(settings, *references.values())

    def evaluate(self, act: Policy) -> dict[str, float]:
        """See :class:`train.interface.Evaluator`."""
        figures: dict[str, float] = {}
        clips = len(self._references)
        starts = {name: clips * math.ceil(number / clips) for name, number in STARTS.items()}
        for name, settings in self._settings.items():
            env = build_environment(
                settings, self._robot, self._references, num_envs=starts[name], seed=self._seed, threads=self._threads
            )
            figures |= {f"{name}_{key}": value for key, value in _play(env, act).items()}
        scores = [
            figures[f"{name}_empbpe_mm"]
            + ERROR_WEIGHT * figures[f"{name}_eg_mpbpe_mm"]
            + FALL_COST * figures[f"{name}_falls"]
            for name in self._settings
        ]
        falls = {name: figures[f"{name}_falls"] for name in self._settings}
        error = FALL_COST * math.sqrt(sum(share * (1.0 - share) / starts[name] for name, share in falls.items()))
        return {"score": sum(scores) / len(scores), "score_error": error / len(scores), **figures}


def fall_height_m(*references: Reference) -> float:
    """A root that is no higher above what lies under it has fallen: a share of how high the lowest clip begins."""
    return FALL_HEIGHT_SHARE * min(float(r.scene.above(r.root_pos_w[0])) for r in references)


def whole_clip(settings: EnvironmentSettings, *references: Reference) -> dict[str, EnvironmentSettings]:
    """Settings under which robots play from noisy starts until they fall: nominal and randomized ones."""
    full = CurriculumSettings(start=1.0, easy=1.0, hard=1.0, factor=0.0)
    common = replace(
        settings,
        randomization=replace(settings.randomization, nominal_share=0.0),
        start=StartSettings(first_frame=1.0, joint_noise_rad=START_NOISE_RAD),
        termination=TerminationSettings(
            terms={"tilt": {"limit": 2.0}, "height": {"min_m": fall_height_m(*references)}}, max_episode_s=1e9
        ),
        clips=ClipSettings(in_turn=True),
        teacher=None,
    )
    none = CurriculumSettings(start=0.0, easy=0.0, hard=0.0, factor=0.0)
    return {
        "nominal": replace(common, randomization_scale=none),
        "randomized": replace(common, randomization_scale=full),
    }


def _play(env: TrackingEnv, act: Policy) -> dict[str, float]:
    """Falls (share), length until the end or the first fall (share of the clip), and mean errors until then."""
    observations: Mapping[str, torch.Tensor] = env.reset()
    clip, ticks = env.state.clip.clone(), env.command.num_ticks
    alive = torch.ones(env.num_envs, dtype=torch.bool)
    playing = alive.clone()
    sums = {"eg_mpbpe_mm": 0.0, "empbpe_mm": 0.0, "empjpe_mrad": 0.0}
    steps = 0
    for _ in range(int(ticks.max())):
        result = env.step(act(observations["actor"]))
        observations = result.observations
        alive &= ~(result.terminated & playing)
        playing &= alive
        if not playing.any():
            break
        for name, values in env.last_errors.items():
            sums[name] += float(values[playing].sum())
        steps += int(playing.sum())
        playing &= ~result.timed_out
    errors = {name: total / max(steps, 1) for name, total in sums.items()}
    survival = {"falls": 1.0 - float(alive.float().mean()), "length_ratio": steps / int(ticks[clip].sum())}
    each = {f"clip/{name}/survival": float(alive[clip == i].float().mean()) for i, name in enumerate(env.command.names)}
    return survival | (errors if steps else dict.fromkeys(sums, float("inf"))) | (each if len(each) > 1 else {})
