"""A clip that an actor gets at run time: can it be done, is it known, and how does it end in simulation?"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from deploy.actor_run import ActorRun
from deploy.episode import run_episode, simulated_rig
from deploy.preflight import Check
from deploy.settings import DeploySettings
from motion.envelope import envelope_from, novelty
from motion.filter import judge
from motion.importers.csv_joints import ASSUMED, rate_assumed
from robot.robot import Robot
from world.options import load_sim_options

EPISODES = 3
START_NOISE_RAD = 0.02


def check_clip(run: ActorRun, robot: Robot, *, binding: bool) -> list[Check]:
    """Whether the clip is trackable at all, and how near it is to what the actor was trained on.

    Nothing for an actor that carries its clip. binding: whether a clip that nobody can perform fails the check.
    """
    if run.actor.spec.follows != "any_clip" or run.clip is None or run.reference is None:
        return []
    verdict = judge((run.clip, robot))
    envelope = envelope_from(run.actor.spec.provenance)
    known = "its actor does not say what it was trained on"
    if envelope is not None:
        known = str(novelty(run.reference, robot, envelope))
    found, assumed = [known] if verdict.stable else list(verdict.reasons), rate_assumed(run.clip)
    if assumed:
        found.append(f"{ASSUMED} (motion/process --fps makes a clip that does)")
    remarkable = assumed or not verdict.stable
    return [Check(f"clip {run.name}", verdict.stable or not binding, "; ".join(found), remarkable=remarkable)]


def rehearse(run: ActorRun, robot: Robot, settings: DeploySettings, say: Callable[[str], None]) -> list[Check]:
    """Play a clip that came at run time in simulation; the check passes where every episode ends with the clip.

    The first is the nominal robot's, in the others everything differs that Table 7 lets differ.
    """
    if run.actor.spec.follows != "any_clip" or run.reference is None:
        return []
    say(f"rehearsing {run.name} in simulation, {EPISODES} times {run.reference.duration_s:.1f} s")
    options, faults, errors_mm = load_sim_options("default"), [], []
    for episode in range(EPISODES):
        rig = simulated_rig(robot, settings, run, replace(options, randomize=episode > 0))
        result = run_episode(rig, np.random.default_rng(episode), start_noise_rad=START_NOISE_RAD)
        if result.fell or result.outcome != "completed":
            faults.append(f"at {result.steps * run.period_s:.1f} s {result.fault or 'a fall'}")
        elif (error_mm := result.metrics["empbpe_mm"]) is not None:
            errors_mm.append(error_mm)
    found = f"{EPISODES - len(faults)} of {EPISODES} to the end in simulation"
    if errors_mm:
        found += f", {np.mean(errors_mm):.0f} mm off"
    return [Check(f"rehearsal {run.name}", not faults, "; ".join([found, *faults]))]
