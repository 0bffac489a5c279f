"""Observation layouts that training uses by name."""

from __future__ import annotations

from policy.spec import ObservationGroup, ObservationTerm

PBHC_SCALES = {"base_ang_vel": 0.25, "dof_vel": 0.05}  # of every other term 1
OLDER_TERMS = ("actions", "base_ang_vel", "dof_pos", "projected_gravity")


def pbhc_actor_group(name: str = "actor_obs", older_lags: tuple[int, ...] = ()) -> ObservationGroup:
    """The layout of PBHC's released actors: 380 numbers for 23 joints (paper Table 5, released config).

    ``older_lags`` (beyond 4) add ``OLDER_TERMS`` of earlier ticks at the end, term by term.
    """

    def at(term: str, *lags: int) -> ObservationTerm:
        return ObservationTerm(term, lags, PBHC_SCALES.get(term, 1.0))

    now_first = ("actions", "base_ang_vel", "dof_pos", "dof_vel")
    now_last = ("projected_gravity", "ref_motion_phase")
    history = [at(term, 1, 2, 3, 4) for term in now_first + now_last]
    older = [at(term, *older_lags) for term in OLDER_TERMS if older_lags]
    return ObservationGroup(name, (*(at(t, 0) for t in now_first), *history, *(at(t, 0) for t in now_last), *older))


WINDOW_TICKS = (1, 2, 3, 5, 8, 12, 17)
WINDOW_TERMS = (
    "reference_joint_pos", "reference_joint_vel", "reference_root_height", "reference_gravity", "reference_orientation",
    "reference_lin_vel", "reference_ang_vel",
)  # fmt: skip
WINDOW_SCALES = {"reference_joint_vel": 0.05, "reference_ang_vel": 0.25}


def window_actor_group(name: str = "actor_obs", ticks: tuple[int, ...] = WINDOW_TICKS) -> ObservationGroup:
    """Five ticks of what the robot measures and did, and the reference ``ticks`` ahead: for actors of any clip."""
    measured = ("base_ang_vel", "projected_gravity", "dof_pos", "dof_vel", "actions")
    terms = [ObservationTerm(term, (0, 1, 2, 3, 4), PBHC_SCALES.get(term, 1.0)) for term in measured]
    terms += [ObservationTerm(term, (0,), WINDOW_SCALES.get(term, 1.0), ticks=ticks) for term in WINDOW_TERMS]
    return ObservationGroup(name, tuple(terms))
