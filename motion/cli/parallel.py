"""Jobs in processes of their own, several at a time: one that fails, or dies, is not the others' business."""

import multiprocessing
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import resource_tracker
from typing import TypeVar

from core.command import STOPPED
from core.processes import end_with_parent, one_thread_each

Job = TypeVar("Job")


def run_all(work: Callable[[Job], int], jobs: Sequence[Job], workers: int) -> list[int]:
    """Exit code of `work` (a function of a module) for each job; at most `workers` run at once.

    A process that ends by a signal counts as 1. Ctrl-C reaches the processes as well, those that still load their
    modules once they have; no further one starts.
    """
    if len(jobs) == 1:
        return [work(jobs[0])]
    resource_tracker.ensure_running()  # its start would take the deafness from the thread that needs it first
    with one_thread_each(), ThreadPoolExecutor(workers, initializer=_deafen) as pool:
        futures = [pool.submit(_in_a_process, work, job) for job in jobs]
        try:
            return [future.result() for future in futures]
        finally:
            for future in futures:
                future.cancel()


def _in_a_process(work: Callable[[Job], int], job: Job) -> int:
    process = multiprocessing.get_context("spawn").Process(target=_child, args=(work, job), daemon=True)
    process.start()
    process.join()
    return 1 if process.exitcode is None or process.exitcode < 0 else process.exitcode


def _deafen() -> None:
    """Ctrl-C waits in processes that this thread starts: in the middle of their imports it would show a traceback."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _child(work: Callable[[Job], int], job: Job) -> None:
    end_with_parent()
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        code = work(job)
    except KeyboardInterrupt:
        code = STOPPED
    raise SystemExit(code)
