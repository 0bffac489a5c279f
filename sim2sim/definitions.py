"""How scores are shown: short label, unit and definition of each, wherever numbers stand."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motion.metrics import DEFINITIONS
from sim2sim.goal_scores import GOAL_DEFINITIONS


@dataclass(frozen=True)
class Score:
    """One score of an episode. ``key`` is its name in JSON."""

    key: str
    label: str
    unit: str

    @property
    def meaning(self) -> str:
        """Its definition in one line."""
        return (DEFINITIONS | GOAL_DEFINITIONS)[self.key]


SCORES = (
    Score("eg_mpbpe_mm", "Eg-mpbpe", "mm"),
    Score("empbpe_mm", "Empbpe", "mm"),
    Score("empjpe_mrad", "Empjpe", "10⁻³ rad"),
    Score("empjve_mrad", "Empjve", "10⁻³ rad/step"),
    Score("empbve_mm", "Empbve", "mm/step"),
    Score("empbae_mm", "Empbae", "mm/step²"),
    Score("contact_error", "contact error", ""),
    Score("episode_length_ratio", "length ratio", ""),
)
GOAL_SCORES = (
    Score("mpjpe_mm", "MPJPE", "mm"),
    Score("mpojpe_mm", "MPOJPE", "mm"),
    Score("path_error_mm", "path error", "mm"),
    Score("reach_error_mm", "reach error", "mm"),
)
AVERAGING = (
    "Each score is a mean over all steps (20 ms) of an episode until its end or fall; shown is mean ± standard "
    "deviation over episodes. Bodies are the robot's links and tracked points."
)
SUCCESS = GOAL_DEFINITIONS["success"]
SURVIVAL = "share of episodes without a fall (pelvis below 0.3 m) and without a safety trip"


def scores_in(documents: Sequence[Mapping[str, Any]]) -> tuple[Score, ...]:
    """What these runs are scored by: of goals, where any of them has such a score, besides what all have."""
    return (*SCORES, *(score for score in GOAL_SCORES if any(score.key in d["metrics"] for d in documents)))
