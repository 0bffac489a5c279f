#!/usr/bin/env -S python3 -P
"""How many frames of human motion a core of this machine retargets in a second, and what the time goes into.

Without --input: a made-up person who moves every joint at once for 30 s. "per core" counts processor time; --jobs
retargets that many copies at a time, in a process each, and counts the clock's time.
"""

import os
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

# One thread: the arrays are small. Before numpy is loaded.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import daqp
import numpy as np

from core.arguments import ArgumentParser, count_argument
from core.command import guarded
from core.errors import InputError
from core.files import check_output_file, write_json
from core.rotations import quat_from_rotvec
from motion.contact import contact_of, staying_contact
from motion.human.correct import correct_height
from motion.human.motion import JOINTS, HumanMotion
from motion.human.skeleton import FEET, MEAN_SKELETON, posed, soles_w
from motion.read import read_motion
from motion.retarget import retarget as module
from motion.retarget.body import Body
from motion.retarget.settings import load_settings
from motion.retarget.solver import FrameSolver
from robot.robot import load_robot

FPS, DURATION_S = 30.0, 30.0
SWING_RAD = 0.25
PHASES: dict[str, tuple[Any, str]] = {
    "targets": (module, "_targets"),
    "kinematics": (Body, "pose"),
    "distances": (Body, "distances"),
    "errors": (FrameSolver, "_errors"),
    "daqp": (daqp, "solve"),
    "rest of steps": (FrameSolver, "_step"),
    "rest of problems": (FrameSolver, "_problem"),
}


def made_up_person() -> HumanMotion:
    """Every joint turns about every axis, to and fro at its own pace."""
    random, time_s = np.random.default_rng(0), np.arange(round(FPS * DURATION_S)) / FPS
    shape = (1, len(JOINTS), 3)
    pace, start = random.uniform(1.0, 4.0, shape), random.uniform(0.0, 2.0 * np.pi, shape)
    local = quat_from_rotvec(SWING_RAD * np.sin(pace * time_s[:, None, None] + start))
    pos, quat = posed(MEAN_SKELETON, np.zeros((len(time_s), 3)), local)
    soles = soles_w(MEAN_SKELETON.sole_m, MEAN_SKELETON.offset_m[list(FEET)], pos, quat)
    up = -soles[..., 2].min(axis=(1, 2))[:, None] * np.array([0.0, 0.0, 1.0])
    return HumanMotion(FPS, pos + up[:, None], quat, soles + up[:, None, None], "made up", "none")


@contextmanager
def timed_phases(seconds: dict[str, float], calls: dict[str, int]) -> Iterator[None]:
    """Collect processor time and calls of each phase, without the phases inside it."""
    inner_s: list[float] = []

    def timed(phase: str, function: Callable) -> Callable:
        def call(*arguments: Any, **named: Any) -> Any:
            inner_s.append(0.0)
            start_s = time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                taken_s = time.process_time() - start_s
                seconds[phase] += taken_s - inner_s.pop()
                calls[phase] += 1
                if inner_s:
                    inner_s[-1] += taken_s

        return call

    with ExitStack() as stack:
        for phase, (owner, name) in PHASES.items():
            original = getattr(owner, name)
            setattr(owner, name, timed(phase, original))
            stack.callback(setattr, owner, name, original)
        yield


def processor_time_s(human: HumanMotion, contact: np.ndarray) -> float:
    """Seconds of one core that retargeting takes."""
    robot = load_robot()
    settings = load_settings(robot)
    start_s = time.process_time()
    module.retarget(human, contact, robot, settings)
    return time.process_time() - start_s


def measure(human: HumanMotion, jobs: int) -> dict[str, Any]:
    """The figures that main prints."""
    contact = staying_contact(human, contact_of(human))
    human = correct_height(human, contact)
    whole_s = processor_time_s(human, contact)
    seconds: dict[str, float] = defaultdict(float)
    calls: dict[str, int] = defaultdict(int)
    with timed_phases(seconds, calls):
        processor_time_s(human, contact)
    figures = {
        "frames": human.num_frames,
        "frames_per_s_per_core": human.num_frames / whole_s,
        "steps_per_frame": calls["daqp"] / human.num_frames,
        "shares": {phase: seconds[phase] / sum(seconds.values()) for phase in PHASES},
    }
    if jobs:
        with ProcessPoolExecutor(jobs) as pool:
            list(pool.map(processor_time_s, [human] * jobs, [contact] * jobs))  # starts the processes
            start_s = time.perf_counter()
            list(pool.map(processor_time_s, [human] * jobs, [contact] * jobs))
            figures |= {"jobs": jobs, "frames_per_s": jobs * human.num_frames / (time.perf_counter() - start_s)}
    return figures


@guarded
def main() -> int:
    """Print the figures and, on request, write them as JSON. Returns the exit code."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--input", type=Path, metavar="FILE", help="a human recording: BVH or SMPL parameters")
    parser.add_argument("--jobs", type=count_argument, default=0, metavar="N", help="also N copies at a time")
    parser.add_argument("--json", type=Path, metavar="F")
    options = parser.parse_args()
    check_output_file("--json", options.json)
    human = read_motion(options.input, robot=load_robot()) if options.input else made_up_person()
    if not isinstance(human, HumanMotion):
        raise InputError("a robot's motion", where=options.input, expected="a human's")
    figures = measure(human, options.jobs)
    print(f"{figures['frames']} frames, {figures['frames_per_s_per_core']:.0f} frames/s per core, ", end="")
    print(f"{figures['steps_per_frame']:.1f} steps a frame")
    for phase, share in figures["shares"].items():
        print(f"  {phase:18} {share:6.1%}")
    if options.jobs:
        print(f"{options.jobs} at a time: {figures['frames_per_s']:.0f} frames/s together")
    if options.json:
        write_json(options.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
