"""Jobs in processes of their own, several at a time: one that fails, or dies, is not the others' business."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from core.processes import end_with_parent, one_thread_each

Job = TypeVar("Job")


def run_all(work: Callable[[Job], int], jobs: Sequence[Job], workers: int) -> list[int]:
    """Exit code of `work` (a function of a module) for each job; at most `workers` run at once.

    A process that ends by a signal counts as 1. Ctrl-C reaches the processes as well; no further one starts.
    """
    if len(jobs) == 1:
        return [work(jobs[0])]
    with one_thread_each(), ThreadPoolExecutor(workers) as pool:
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


def _child(work: Callable[[Job], int], job: Job) -> None:
    end_with_parent()
    raise SystemExit(work(job))
