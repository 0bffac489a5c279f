"""From the scores of single episodes to the numbers of an evaluation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from motion.metrics import METRIC_KEYS, over_episodes
from sim2sim.episode import EpisodeScore
from sim2sim.goal_scores import GOAL_DEFINITIONS


@dataclass(frozen=True)
class WorstFrame:
    """The step with the largest Eg-mpbpe of all episodes."""

    episode: int
    tick: int
    error_mm: float


def survival_rate(episodes: Sequence[EpisodeScore]) -> float:
    """Share of episodes that reached their end."""
    return sum(episode.survived for episode in episodes) / len(episodes)


def worst_frame(episodes: Sequence[EpisodeScore]) -> WorstFrame | None:
    """Where the mean distance of the tracked points from the reference is largest; None without any step."""
    worst: WorstFrame | None = None
    for index, episode in enumerate(episodes):
        error_mm = episode.body_error_mm.mean(axis=1)
        if error_mm.size and (worst is None or error_mm.max() > worst.error_mm):
            worst = WorstFrame(index, int(error_mm.argmax()), float(error_mm.max()))
    return worst


def run_document(policy_sha256: str, motion: str, sim: str, episodes: Sequence[EpisodeScore]) -> dict[str, Any]:
    """The JSON object of one policy's evaluation; of an actor that follows goals it has the scores of goals besides."""
    summary = over_episodes([episode.scores for episode in episodes])
    success = summary.pop("success", None)
    return {
        "policy_sha256": policy_sha256,
        "motion": motion,
        "sim": sim,
        "episodes": len(episodes),
        "survival_rate": survival_rate(episodes),
        **({} if success is None else {"success_rate": success["mean"]}),
        "metrics": {key: summary[key] for key in (*METRIC_KEYS, *(key for key in GOAL_DEFINITIONS if key in summary))},
    }
