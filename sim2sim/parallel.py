"""Episodes in parallel processes. An episode's result depends on its job alone, never on who played it or when."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from types import FrameType

from core.processes import available_cores, end_with_parent, one_thread_each
from sim2sim.episode import EpisodeScore
from sim2sim.player import Player
from sim2sim.request import EvaluationRequest

Job = tuple[int, int]  # index of the run, index of the episode
LOOK_S = 0.1  # so long a stop may wait


def default_workers(num_jobs: int) -> int:
    """One process a core that this one may use, never more than there are jobs."""
    return max(1, min(available_cores(), num_jobs))


def play_all(
    player: Player, jobs: Sequence[Job], on_done: Callable[[Job, EpisodeScore], None], workers: int
) -> dict[Job, EpisodeScore]:
    """Play every job and call `on_done` as each ends. One worker: the given player, in this process.

    Raises OSError where a worker process is killed, and KeyboardInterrupt on Ctrl-C, after all of them have ended.
    """
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
    context, played = multiprocessing.get_context("spawn"), 0
    came: list[int] = []
    with (
        one_thread_each(),
        ProcessPoolExecutor(workers, context, _prepare, (request,)) as pool,
        _on_ctrl_c(lambda number, frame: came.append(number)),
    ):
        with _on_ctrl_c(signal.SIG_IGN):  # it reaches the whole group, but the workers are this process's to end
            futures = {pool.submit(_play, job): job for job in jobs}
        pending = set(futures)
        try:
            while pending:
                done, pending = wait(pending, LOOK_S, FIRST_COMPLETED)
                if came:
                    raise KeyboardInterrupt
                for future in done:
                    yield futures[future], future.result()
                    played += 1
        except BrokenProcessPool as error:
            what = f"a worker process ended (out of memory?): got {played} of {len(jobs)} episodes"
            raise ChildProcessError(what) from error
        finally:
            if pending:
                for process in multiprocessing.active_children():
                    process.terminate()
            pool.shutdown(cancel_futures=True)


@contextmanager
def _on_ctrl_c(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> Iterator[None]:
    """What it does within, unless it was ignored before, as in a shell's background."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, handler)
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
