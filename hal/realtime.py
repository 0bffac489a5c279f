"""What the operating system can do for punctuality, taken where it is permitted and said where it is not.

All of it belongs to the calling thread: threads started before keep their own scheduling and cores.
"""

import ctypes
import gc
import os
import resource
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PRIORITY = 50
WIRE_PRIORITY = 60
EMULATOR_PRIORITY = 40
MCL_CURRENT_AND_FUTURE = 3
LAST_TO_BE_ENDED = -1000
# The stack of a new thread is then made whole at once, while all others wait: not the system's 8 MiB.
STACK_BYTES = 2**19


@contextmanager
def realtime(say: Callable[[str], None]) -> Iterator[None]:
    """SCHED_FIFO, locked memory and one core while the block runs; `say` gets one line for each, granted or why not."""
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    cores = os.sched_getaffinity(0)
    for ask in (lock_memory, pin, schedule):  # the first takes long; what has no such priority would stand still
        say(f"realtime: {ask()}")
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
        _schedule_as(policy, priority)
        ctypes.CDLL(None).munlockall()


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Pauses of the collector stay out of the loop."""
    was_on = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def schedule(priority: int = PRIORITY, *, inherited: bool = False) -> str:
    """SCHED_FIFO for the calling thread, and with `inherited` for those that it starts; says what was granted."""
    policy = os.SCHED_FIFO if inherited else os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        return f"no SCHED_FIFO ({error.strerror})"
    return f"SCHED_FIFO, priority {priority}"


def _schedule_as(policy: int, priority: os.sched_param) -> None:
    """Back to an earlier scheduling as far as it is permitted: who has SCHED_FIFO by a limit alone may not take
    SCHED_RESET_ON_FORK back."""
    for wanted in (policy, policy | os.SCHED_RESET_ON_FORK):
        with suppress(PermissionError):
            os.sched_setscheduler(0, wanted, priority)
            return


def lock_memory() -> str:
    """Lock the process's memory, only where the limit cannot make a later allocation fail; says what was granted."""
    if os.geteuid() != 0 and resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] != resource.RLIM_INFINITY:
        return "memory not locked (the memlock limit is not unlimited)"
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT_AND_FUTURE) != 0:
        return f"memory not locked ({os.strerror(ctypes.get_errno())})"
    threading.stack_size(STACK_BYTES)
    return "memory locked"


def spare() -> str:
    """Have the kernel end any other process first where memory runs out; says what was granted."""
    try:
        Path("/proc/self/oom_score_adj").write_text(str(LAST_TO_BE_ENDED))
    except OSError as error:
        return f"not spared where memory runs out ({error.strerror})"
    return "spared where memory runs out"


def pin() -> str:
    """Keep the calling thread on the last of its cores; says what was granted."""
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        return "one core only, nothing to pin"
    core = max(cores)
    try:
        os.sched_setaffinity(0, {core})
    except OSError as error:
        return f"not pinned to a core ({error.strerror})"
    return f"pinned to core {core}"
