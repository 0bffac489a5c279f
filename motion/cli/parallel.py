"""Jobs in processes of their own, several at a time: one that fails, or dies, is not the others' business."""

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

Job = TypeVar("Job")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_all(work: Callable[[Job], int], jobs: Sequence[Job], workers: int) -> list[int]:
    """Exit code of `work` (a function of a module) for each job; at most `workers` run at once.

    A process that ends by a signal counts as 1. Ctrl-C reaches the processes as well; no further one starts.
    """
    if len(jobs) == 1:
        return [work(jobs[0])]
    with _one_thread_each(), ThreadPoolExecutor(workers) as pool:
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
    threading.Thread(target=_end_with_parent, daemon=True).start()
    raise SystemExit(work(job))


def _end_with_parent() -> None:
    """However the parent ends, killed for example, nothing goes on working."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes started within find the libraries' own threading off; they read these when they are imported."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
