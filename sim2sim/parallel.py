"""Episodes in parallel processes. An episode's result depends on its job alone, never on who played it or when."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager

from core.processes import available_cores, end_with_parent, one_thread_each
from sim2sim.episode import EpisodeScore
from sim2sim.player import Player
from sim2sim.request import EvaluationRequest

Job = tuple[int, int]  # index of the run, index of the episode


def default_workers(num_jobs: int) -> int:
    """One process a core that this one may use, never more than there are jobs."""
    return max(1, min(available_cores(), num_jobs))


def play_all(
    player: Player, jobs: Sequence[Job], on_done: Callable[[Job, EpisodeScore], None], workers: int
) -> dict[Job, EpisodeScore]:
    """Play every job and call `on_done` as each ends. One worker: the given player, in this process."""
    scores: dict[Job, EpisodeScore] = {}
    results = _serial(player, jobs) if workers == 1 else _parallel(player.request, jobs, workers)
    for job, score in results:
        scores[job] = score
        on_done(job, score)
    return scores


def _serial(player: Player, jobs: Sequence[Job]) -> Iterator[tuple[Job, EpisodeScore]]:
    for job in jobs:
        yield job, player.play(*job)


def _parallel(request: EvaluationRequest, jobs: Sequence[Job], workers: int) -> Iterator[tuple[Job, EpisodeScore]]:
    context = multiprocessing.get_context("spawn")
    with one_thread_each(), ProcessPoolExecutor(workers, context, _prepare, (request,)) as pool:
        with _interrupts_ignored():
            futures = {pool.submit(_play, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Processes started within are deaf to Ctrl-C, which reaches the whole group: this one ends them."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


_players: list[Player] = []  # the one of this worker process, built once


def _prepare(request: EvaluationRequest) -> None:
    end_with_parent()
    _players.append(Player(request))


def _play(job: Job) -> EpisodeScore:
    return _players[0].play(*job)
