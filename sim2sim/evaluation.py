"""All episodes of all policies of one request, and the numbers that follow from them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from deploy.clip_check import check_clip
from sim2sim.aggregate import run_document, worst_frame
from sim2sim.episode import EpisodeScore
from sim2sim.parallel import Job, default_workers, play_all
from sim2sim.player import Player
from sim2sim.request import EvaluationRequest
from world.scene import Scene


@dataclass(frozen=True)
class Run:
    """The episodes of one policy with one clip, in order; `document` is their JSON object."""

    name: str
    scene: Scene
    episodes: Sequence[EpisodeScore]
    document: dict[str, Any]


@dataclass(frozen=True)
class Evaluation:
    """What an evaluation found. `player` knows robot and actors."""

    request: EvaluationRequest
    player: Player
    runs: Sequence[Run]

    def document(self) -> dict[str, Any]:
        """The JSON document: the run itself, or `{"runs": [...]}` for several."""
        documents = [run.document for run in self.runs]
        return documents[0] if len(documents) == 1 else {"runs": documents}

    def remarks(self) -> list[str]:
        """What keeps clips from being performed, where each run was worst, and what ended episodes early, in words."""
        checks = [one for run in self.player.runs for one in check_clip(run, self.player.robot, binding=False)]
        lines = list(dict.fromkeys(f"{check.what}: {check.found}" for check in checks if check.remarkable))
        for run in self.runs:
            worst = worst_frame(run.episodes)
            if worst is not None:
                time_s = self.player.period_s * (worst.tick + 1)
                lines.append(
                    f"{run.name}: worst frame in episode {worst.episode} at {time_s:.2f} s, {worst.error_mm:.0f} mm"
                )
            causes = [episode.ended for episode in run.episodes if not episode.survived]
            for cause in sorted(set(causes)):
                lines.append(f"{run.name}: {causes.count(cause)} of {len(run.episodes)} ended early by {cause}")
        return lines


def evaluate(
    player: Player, on_done: Callable[[Job, EpisodeScore], None] = lambda job, score: None, workers: int | None = None
) -> Evaluation:
    """Play every policy of the player's request in the same episodes. workers: None for one a core."""
    request = player.request
    jobs = [(run, episode) for episode in range(request.episodes) for run in range(len(player.runs))]
    scores = play_all(player, jobs, on_done, default_workers(len(jobs)) if workers is None else workers)
    runs = []
    for index, (name, run) in enumerate(zip(player.names(), player.runs, strict=True)):
        episodes = [scores[index, episode] for episode in range(request.episodes)]
        document = run_document(run.actor.sha256, run.name, request.sim, episodes)
        runs.append(Run(name, run.scene, episodes, document))
    return Evaluation(request, player, runs)
