#!/usr/bin/env -S python3 -P
"""How near bundled actors come to the safety rules' limits, and whether a trip was right.

Peaks are of what the rules see, noise included, over whole episodes that do not fall, while joints are driven: of the
largest value that lasts as long as the rule asks for; of lean, turn and joint speed, away from what the clip asks.
Nominal episodes stand up on the gantry, play and stand; others are randomised and begin at the clip's first frame.
A tripped episode is played again without rules on the body: where the pelvis never sinks below 0.45 m, the trip was
false.
"""

import dataclasses
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from core.arguments import ArgumentParser
from core.command import guarded
from core.files import check_output_file, write_json
from deploy.actors import load_run, load_runs
from deploy.control.modes import RESTING
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.episode import EpisodeResult, EpisodeRig, Start, run_episode, simulated_rig
from deploy.safety.body import lean_away_rad, speed_away_rad_s, turn_away_rad_s
from deploy.safety.rules import make_sample
from deploy.safety.trips import ticks_of
from deploy.settings import DeploySettings, load_settings
from hal.contract.types import RobotState
from hal.simulated.mujoco import MujocoBackend
from motion.clip_set import NamedClip, open_clips
from policy.actor import bundled_actors, resolve_actor
from policy.metadata import read_metadata
from robot.robot import Robot, load_robot
from world.options import load_sim_options

FALLEN_M = 0.45
NEVER = 1e9
PEAKS = ("tilt_rad", "base_rate_rad_s", "joint_speed_share", "torque_share", "torque_share_of_several")


class Watch:
    """An observer: what the rules on the body see, tick by tick, and how low the pelvis gets off the gantry."""

    def __init__(self, robot: Robot, backend: MujocoBackend, joints: int) -> None:
        self._robot, self._backend, self._joints = robot, backend, joints
        self.rows: list[list[float]] = []
        self.lowest_m = math.inf

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        if state is None or state.truth is None:
            return
        if not self._backend.gantry_attached:
            self.lowest_m = min(self.lowest_m, float(self._backend.scene.above(state.truth.root_pos_w)))
        if result.mode in RESTING:
            return
        sample = make_sample(state, asked=None if result.actor is None else result.actor.asked)
        speed = float((speed_away_rad_s(sample) / self._robot.vel_limit_rad_s).max())
        torque = np.sort(np.abs(state.joint_torque_nm) / self._robot.torque_limit_nm)
        strained = float(torque[-self._joints])
        self.rows.append([lean_away_rad(sample), turn_away_rad_s(sample), speed, float(torque[-1]), strained])

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
        joint_speed=dataclasses.replace(settings.safety.joint_speed, factor=NEVER, max_factor=NEVER),
        torque_saturation=dataclasses.replace(settings.safety.torque_saturation, factor=NEVER),
        tilt=dataclasses.replace(settings.safety.tilt, away_rad=NEVER, max_rad=NEVER),
        base_rate=dataclasses.replace(settings.safety.base_rate, away_rad_s=NEVER, max_rad_s=NEVER),
    )
    return dataclasses.replace(settings, safety=safety)


def play(rig: EpisodeRig, episode: int, start: Start) -> tuple[EpisodeResult, Watch]:
    """One episode under watch."""
    watch = Watch(rig.robot, rig.backend, rig.settings.safety.torque_saturation.joints)
    noise_rad = 0.02 if start is Start.STAND else 0.0
    rng = np.random.default_rng(episode)
    return run_episode(rig, rng, start=start, start_noise_rad=noise_rad, observers=[watch]), watch


@dataclasses.dataclass
class Row:
    """What the episodes of one actor, with all of its clips, came to. false: trips of episodes that do not fall."""

    actor: str
    condition: str
    episodes: int = 0
    falls: int = 0
    false: list[str] = dataclasses.field(default_factory=list)
    peaks: list[list[float]] = dataclasses.field(default_factory=list)

    def figures(self) -> dict[str, object]:
        """For the table: the largest peaks of all episodes that ended well."""
        counts = {"episodes": self.episodes, "falls": self.falls, "false_trips": len(self.false)}
        largest = np.max(self.peaks, axis=0).tolist() if self.peaks else [math.nan] * len(PEAKS)
        return {"actor": self.actor, "condition": self.condition} | counts | dict(zip(PEAKS, largest))


def measure(name: str, clips: Sequence[NamedClip], episodes: int, randomize: bool) -> Row:
    """Play `episodes` of each clip, or of the actor's own where there are none."""
    robot, settings = load_robot(), load_settings()
    start = Start.REFERENCE if randomize else Start.STAND
    options = dataclasses.replace(load_sim_options("default"), randomize=randomize)
    stand = load_run("stand", None, robot, settings.entry) if start is Start.STAND else None
    row = Row(name if not clips else f"{name}, {len(clips)} clips", "randomised" if randomize else "nominal")
    for run in load_runs([name], clips, robot, settings.entry):
        rig = simulated_rig(robot, settings, run, options, stand=stand)
        _play_all(rig, episodes, start, row)
        rig.backend.close()
    print(f"{row.actor}: {row.falls} falls; false trips: {row.false or 'none'}", file=sys.stderr)
    return row


def _play_all(rig: EpisodeRig, episodes: int, start: Start, row: Row) -> None:
    unruly = dataclasses.replace(rig, settings=without_body_rules(rig.settings))
    safety, period_s = rig.settings.safety, rig.actor.period_s
    saturation_s = safety.torque_saturation.for_s
    lasting_s = (safety.tilt.for_s, safety.base_rate.for_s, safety.joint_speed.for_s, saturation_s, saturation_s)
    ticks = tuple(ticks_of(seconds, period_s) for seconds in lasting_s)
    for episode in range(episodes):
        row.episodes += 1
        result, watch = play(rig, episode, start)
        if result.outcome == "completed":
            row.peaks.append(watch.peaks(ticks))
        elif result.outcome == "fell" or play(unruly, episode, start)[1].lowest_m < FALLEN_M:
            row.falls += 1
        else:
            row.false.append(f"{rig.actor.name}, episode {episode}: {result.fault}")


@guarded
def main() -> int:
    """0: no trip was false, 1: one was."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument(
        "--actor", action="append", choices=bundled_actors(), help="default: those that carry their clip"
    )
    parser.add_argument(
        "--motion", action="append", metavar="FILE", help="clip, folder or manifest for an actor that carries none"
    )
    parser.add_argument(
        "--episodes", type=int, default=100, help="randomised ones of each actor and clip (default: %(default)s)"
    )
    parser.add_argument("--nominal", type=int, default=3, help="nominal ones (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="where the rows go")
    given = parser.parse_args()
    check_output_file("--json", given.json)
    rows: list[dict[str, object]] = []
    clips = open_clips(given.motion or (), load_robot())
    with_clips = [name for name in bundled_actors() if read_metadata(resolve_actor(name)).spec.motion is not None]
    for name in given.actor or with_clips:
        rows += [
            measure(name, clips, given.nominal, False).figures(),
            measure(name, clips, given.episodes, True).figures(),
        ]
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
