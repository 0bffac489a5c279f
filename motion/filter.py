"""The filter: can a motion be followed at all? Eq. 1 of the paper, and what it cannot see."""

from dataclasses import dataclass

import numpy as np

from motion import plausibility
from motion.clip import Clip
from motion.human.motion import HumanMotion
from motion.physics_checks import com_cop_distance_m
from motion.plausibility import FilterSettings, Finding
from motion.settings import read_section
from motion.track import SupportTrack, track_clip, track_human
from robot.robot import Robot

_RULES = (
    plausibility.flight,
    plausibility.sinking,
    plausibility.tilt,
    plausibility.jump,
    plausibility.spin,
    plausibility.speed,
    plausibility.force,
)


@dataclass(frozen=True, eq=False)
class Verdict:
    """distance_m (N,): Eq. 1's distance of centre of mass and pressure, infinite with nothing near the ground; and
    what every rule found."""

    distance_m: np.ndarray
    findings: tuple[Finding, ...]

    @property
    def stable(self) -> bool:
        """Whether the motion keeps every rule."""
        return all(finding.passed for finding in self.findings)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not stable, in words; empty where it is."""
        return tuple(finding.reason for finding in self.findings if not finding.passed)

    @property
    def failing_frames(self) -> np.ndarray:
        """(K,) frames that break a rule, in order; a stable motion may have some, but not too many."""
        return np.unique(np.concatenate([finding.frames for finding in self.findings]))


def judge(motion: HumanMotion | tuple[Clip, Robot], settings: FilterSettings | None = None) -> Verdict:
    """Verdict on a human's motion, or on a clip and its robot; `settings` by default from configs/motion/process.yaml.

    Raises InputError when the clip's joints are not the robot's, or the settings are wrong.
    """
    settings = settings or read_section(FilterSettings, "filter")
    if isinstance(motion, HumanMotion):
        return judge_track(track_human(motion, settings.max_point_speed_m_s), settings)
    clip, robot = motion
    return judge_track(track_clip(clip, robot, settings.max_joint_speed_factor), settings)


def judge_track(track: SupportTrack, settings: FilterSettings) -> Verdict:
    """Verdict on the arrays alone."""
    distance_m = com_cop_distance_m(track.com_w, track.bearing_w)
    balance = plausibility.balance(track, distance_m, settings)
    return Verdict(distance_m, (balance, *(rule(track, settings) for rule in _RULES)))
