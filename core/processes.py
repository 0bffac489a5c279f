"""What processes that share one command's work need: cores, libraries without threads, an end with their parent."""

import multiprocessing
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def without_windows() -> dict[str, str]:
    """The environment for a process that shows nothing: importing MuJoCo then looks for no window system (0.2 s)."""
    return {**os.environ, "MUJOCO_GL": "disable"}


@contextmanager
def one_thread_each() -> Iterator[None]:
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


def end_with_parent() -> None:
    """Called in a child: however the parent ends, killed for example, the child does not go on without it."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
