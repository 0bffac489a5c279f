#!/usr/bin/env -S python3 -P
"""How near bundled actors come to the safety rules' limits, and whether a trip was right.

Peaks are of what the rules see, noise included, over whole episodes that do not fall, while joints are driven: of the
largest value that lasts as long as the rule asks for. Nominal episodes stand up on the gantry, play and stand; others
are randomised and begin at the clip's first frame. A tripped episode is played again without rules on the body: where
the pelvis never sinks below 0.45 m, the trip was false.
"""

import argparse
import dataclasses
import math
import sys
from pathlib import Path

try:
    import numpy as np

    from core.files import write_json
    from deploy.actors import load_run
    from deploy.control.states import RESTING
    from deploy.control.tick import TickResult
    from deploy.control.timing import PhaseTimer
    from deploy.episode import EpisodeResult, EpisodeRig, Start, run_episode, simulated_rig
    from deploy.safety.rules import tilt_rad
    from deploy.safety.trips import ticks_of
    from deploy.settings import DeploySettings, load_settings
    from hal.contract.types import RobotState
    from hal.simulated.mujoco import MujocoBackend
    from policy.actor import bundled_actors, resolve_actor
    from policy.metadata import read_metadata
    from robot.robot import Robot, load_robot
    from world.options import load_sim_options
except ModuleNotFoundError as error:
    hint = 'kata is not installed in this Python: run "make install", then ". .venv/bin/activate"'
    print(f"{hint} (no module {error.name})", file=sys.stderr)
    sys.exit(2)

FALLEN_M = 0.45
NEVER = 1e9
PEAKS = ("tilt_rad", "base_rate_rad_s", "joint_speed_share", "torque_share", "second_torque_share")


class Watch:
    """An observer: what the rules on the body see, tick by tick, and how low the pelvis gets off the gantry."""

    def __init__(self, robot: Robot, backend: MujocoBackend) -> None:
        self._robot, self._backend = robot, backend
        self.rows: list[list[float]] = []
        self.lowest_m = math.inf

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        if state is None or state.truth is None:
            return
        if not self._backend.gantry_attached:
            self.lowest_m = min(self.lowest_m, float(state.truth.root_pos_w[2]))
        if result.mode in RESTING:
            return
        speed = float((np.abs(state.joint_vel_rad_s) / self._robot.vel_limit_rad_s).max())
        torque = np.sort(np.abs(state.joint_torque_nm) / self._robot.torque_limit_nm)
        rate = math.hypot(*state.imu_ang_vel_b.tolist())
        self.rows.append([tilt_rad(state.imu_quat_wxyz), rate, speed, float(torque[-1]), float(torque[-2])])

    def peaks(self, ticks: tuple[int, ...]) -> list[float]:
        """The largest value of each column that lasts for its number of ticks."""
        columns = np.transpose(self.rows)
        lasting = (np.lib.stride_tricks.sliding_window_view(x, n).min(axis=1) for x, n in zip(columns, ticks))
        return [float(values.max()) for values in lasting]


def without_body_rules(settings: DeploySettings) -> DeploySettings:
    """Settings in which no rule on the body trips."""
    safety = dataclasses.replace(
        settings.safety,
        position_range=dataclasses.replace(settings.safety.position_range, margin_rad=NEVER),
        joint_speed=dataclasses.replace(settings.safety.joint_speed, factor=NEVER),
        torque_saturation=dataclasses.replace(settings.safety.torque_saturation, factor=NEVER),
        tilt=dataclasses.replace(settings.safety.tilt, max_rad=NEVER),
        base_rate=dataclasses.replace(settings.safety.base_rate, max_rad_s=NEVER),
    )
    return dataclasses.replace(settings, safety=safety)


def play(rig: EpisodeRig, episode: int, start: Start) -> tuple[EpisodeResult, Watch]:
    """One episode under watch."""
    watch = Watch(rig.robot, rig.backend)
    noise_rad = 0.02 if start is Start.STAND else 0.0
    rng = np.random.default_rng(episode)
    return run_episode(rig, rng, start=start, start_noise_rad=noise_rad, observers=[watch]), watch


def measure(name: str, motion: str | None, episodes: int, randomize: bool) -> dict[str, object]:
    """One row of the table."""
    robot, settings = load_robot(), load_settings()
    start = Start.REFERENCE if randomize else Start.STAND
    run = load_run(name, motion, robot, settings.entry)
    options = dataclasses.replace(load_sim_options("default"), randomize=randomize)
    stand = load_run("stand", None, robot, settings.entry) if start is Start.STAND else None
    rig = simulated_rig(robot, settings, run, options, stand=stand)
    unruly = dataclasses.replace(rig, settings=without_body_rules(settings))
    safety = settings.safety
    saturation_s = safety.torque_saturation.for_s
    lasting_s = (safety.tilt.for_s, safety.base_rate.for_s, safety.joint_speed.for_s, saturation_s, saturation_s)
    ticks = tuple(ticks_of(seconds, run.period_s) for seconds in lasting_s)
    peaks, falls, false = [], 0, []
    for episode in range(episodes):
        result, watch = play(rig, episode, start)
        if result.outcome != "tripped":
            peaks.append(watch.peaks(ticks))
            continue
        if play(unruly, episode, start)[1].lowest_m < FALLEN_M:
            falls += 1
        else:
            false.append(f"episode {episode}: {result.fault}")
    print(f"{name}: {falls} falls; false trips: {false or 'none'}", file=sys.stderr)
    row = {
        "actor": name if motion is None else f"{name}, {motion}",
        "condition": "randomised" if randomize else "nominal",
        "episodes": episodes,
    }
    return row | {"falls": falls, "false_trips": len(false)} | dict(zip(PEAKS, np.max(peaks, axis=0).tolist()))


def main() -> int:
    """0: no trip was false, 1: one was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--actor", action="append", choices=bundled_actors(), help="default: those that carry their clip"
    )
    parser.add_argument("--motion", metavar="NAME|FILE", help="clip for an actor that carries none")
    parser.add_argument(
        "--episodes", type=int, default=100, help="randomised ones of each actor (default: %(default)s)"
    )
    parser.add_argument("--nominal", type=int, default=3, help="nominal ones of each actor (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="where the rows go")
    given = parser.parse_args()
    rows = []
    with_clips = [name for name in bundled_actors() if read_metadata(resolve_actor(name)).spec.motion is not None]
    for name in given.actor or with_clips:
        rows += [measure(name, given.motion, given.nominal, False), measure(name, given.motion, given.episodes, True)]
        for row in rows[-2:]:
            print(
                "  ".join(
                    f"{key} {value:.2f}" if isinstance(value, float) else str(value) for key, value in row.items()
                )
            )
    if given.json:
        write_json(given.json, {"rows": rows})
    return int(any(row["false_trips"] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
