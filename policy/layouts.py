"""Observation layouts that training uses by name."""

from __future__ import annotations

from collections.abc import Callable

from policy.goals import POINTS
from policy.spec import ObservationGroup, ObservationTerm

PBHC_SCALES = {"base_ang_vel": 0.25, "dof_vel": 0.05}  # of every other term 1


def pbhc_actor_group(name: str = "actor_obs") -> ObservationGroup:
    """The layout of PBHC's released actors: 380 numbers for 23 joints (paper Table 5, released config)."""

    def at(term: str, *lags: int) -> ObservationTerm:
        return ObservationTerm(term, lags, PBHC_SCALES.get(term, 1.0))

    now_first = ("actions", "base_ang_vel", "dof_pos", "dof_vel")
    now_last = ("projected_gravity", "ref_motion_phase")
    history = [at(term, 1, 2, 3, 4) for term in now_first + now_last]
    return ObservationGroup(name, (*(at(t, 0) for t in now_first), *history, *(at(t, 0) for t in now_last)))


WINDOW_TICKS = (1, 2, 3, 5, 8, 12, 17)
WINDOW_TERMS = (
    "reference_joint_pos", "reference_joint_vel", "reference_root_height", "reference_gravity", "reference_orientation",
    "reference_lin_vel", "reference_ang_vel",
)  # fmt: skip
WINDOW_SCALES = {"reference_joint_vel": 0.05, "reference_ang_vel": 0.25}


MEASURED = ("base_ang_vel", "projected_gravity", "dof_pos", "dof_vel", "actions")
STEADIED = (*MEASURED, "filtered_gravity")
TRACKER_LAGS = 5
TRACKER_BLOCKS = (tuple(range(5, 13)), tuple(range(13, 37)))  # of older ticks, which white noise hardly reaches


def tracker_actor_group(name: str = "actor_obs") -> ObservationGroup:
    """What trackers trained through a world model see: what the robot measures and did, tick by tick and on average
    before, and how that compares with the next tick; then the way ahead and the targets that carry it."""

    def ahead(term: str, *ticks: int) -> ObservationTerm:
        return ObservationTerm(term, scale=WINDOW_SCALES.get(term, 1.0), ticks=ticks)

    measured = [
        ObservationTerm(term, (lag,), PBHC_SCALES.get(term, 1.0)) for lag in range(TRACKER_LAGS) for term in STEADIED
    ]
    older = [
        ObservationTerm(term, block, PBHC_SCALES.get(term, 1.0), mean=True)
        for block in TRACKER_BLOCKS
        for term in STEADIED
    ]
    compared = [ahead("reference_joint_error", 1), ahead("reference_heading", 1)]
    coming = [
        ahead("reference_joint_pos", 0, *WINDOW_TICKS), ahead("reference_feedforward", 0),
        ahead("reference_joint_vel", 1),
        *(ahead(t, *WINDOW_TICKS) for t in
          ("reference_root_height", "reference_gravity", "reference_lin_vel", "reference_ang_vel")),
    ]  # fmt: skip
    return ObservationGroup(name, (*measured, *older, *compared, *coming))


def goals_actor_group(name: str = "actor_obs") -> ObservationGroup:
    """What trackers see, part by part, each of which may be hidden; besides, where points of the body shall be, how
    they shall be turned, and how the whole shall move."""

    def ahead(term: str, part: str, *ticks: int, of: str = "") -> ObservationTerm:
        return ObservationTerm(term, scale=WINDOW_SCALES.get(term, 1.0), ticks=ticks, of=of, part=part)

    def all_points(term: str, suffix: str, *ticks: int) -> list[ObservationTerm]:
        return [ahead(term, f"{point}{suffix}", *ticks, of=point) for point in POINTS]

    measured = [entry for entry in tracker_actor_group().terms if not entry.ticks]
    compared = [
        ahead("reference_joint_error", "joints", 1), ahead("reference_heading", "heading", 1),
        ahead("goal_steer", "steer", 1),
        *all_points("goal_point", "", 1, 5, 17), *all_points("goal_turn", "_turn", 1, 17),
    ]  # fmt: skip
    coming = [
        ahead("reference_joint_pos", "joints", 0, *WINDOW_TICKS), ahead("reference_feedforward", "joints", 0),
        ahead("reference_joint_vel", "joints", 1),
        ahead("reference_root_height", "posture", *WINDOW_TICKS), ahead("reference_gravity", "posture", *WINDOW_TICKS),
        ahead("reference_lin_vel", "place", *WINDOW_TICKS), ahead("reference_ang_vel", "heading", *WINDOW_TICKS),
        ahead("goal_visible", "", 0),
    ]  # fmt: skip
    return ObservationGroup(name, (*measured, *compared, *coming))


def window_actor_group(name: str = "actor_obs", ticks: tuple[int, ...] = WINDOW_TICKS) -> ObservationGroup:
    """Five ticks of what the robot measures and did, and the reference ``ticks`` ahead: for actors of any clip."""
    terms = [ObservationTerm(term, (0, 1, 2, 3, 4), PBHC_SCALES.get(term, 1.0)) for term in MEASURED]
    terms += [ObservationTerm(term, (0,), WINDOW_SCALES.get(term, 1.0), ticks=ticks) for term in WINDOW_TERMS]
    return ObservationGroup(name, tuple(terms))


LAYOUTS: dict[str, Callable[..., ObservationGroup]] = {
    "pbhc": pbhc_actor_group, "window": window_actor_group, "tracker": tracker_actor_group,
    "goals": goals_actor_group,
}  # fmt: skip
