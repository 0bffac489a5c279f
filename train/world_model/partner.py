"""An object that works beside this process: in another one that shares its tensors' memory, or, in turn, in this."""

import ctypes
import gc
import multiprocessing
import os
import signal
import traceback
from multiprocessing.connection import Connection
from typing import Any, Protocol

import torch

from core.errors import InputError

PR_SET_PDEATHSIG = 1
ENDED = "the process that learns the policy has ended"
END_S = 30.0  # a call that is under way is waited for so long


class Partner(Protocol):
    """Calls methods of an object; only one call is under way at a time."""

    def begin(self, method: str, *arguments: Any) -> None:
        """Begin a call. Arguments and results are copied, but for what was shared before. RuntimeError as below."""
        ...

    def finish(self) -> Any:
        """Wait for the call's result. InputError where it raised one; RuntimeError where it failed or has ended."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class InTurn:
    """In this process: a call runs when its result is asked for."""

    def __init__(self, target: object) -> None:
        self._target = target
        self._call: tuple[str, tuple[Any, ...]] = "", ()

    def begin(self, method: str, *arguments: Any) -> None:
        """See :class:`Partner`."""
        self._call = method, arguments

    def finish(self) -> Any:
        """See :class:`Partner`."""
        method, arguments = self._call
        return getattr(self._target, method)(*arguments)

    def close(self) -> None:
        """See :class:`Partner`."""


class Beside:
    """In a forked process, which ends with this one, whatever ends it."""

    def __init__(self, target: object) -> None:
        # A pool of threads that only a cycle keeps cannot end in a process that has none of its threads: it ends here.
        gc.collect()
        fork = multiprocessing.get_context("fork")
        self._pipe, its = fork.Pipe()
        self._process = fork.Process(target=_serve, args=(target, its, self._pipe), daemon=True)
        self._process.start()
        its.close()

    def begin(self, method: str, *arguments: Any) -> None:
        """See :class:`Partner`."""
        try:
            self._pipe.send((method, arguments))
        except OSError as error:
            raise RuntimeError(ENDED) from error

    def finish(self) -> Any:
        """See :class:`Partner`."""
        try:
            failed, result = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise RuntimeError(ENDED) from error
        if isinstance(result, InputError):
            raise result
        if failed:
            raise RuntimeError(f"the process that learns the policy failed:\n{result}")
        return result

    def close(self) -> None:
        """See :class:`Partner`."""
        self._pipe.close()
        self._process.join(END_S)
        self._process.kill()


def _serve(target: object, pipe: Connection, others: Connection) -> None:
    """Carry out calls until the other end is closed."""
    torch.set_num_threads(1)  # the threads of who forked are not here, and OpenMP would wait for them for ever
    gc.freeze()
    others.close()
    # Who trains is told to stop, and closes this. Killed, it takes this along: processes forked since hold the pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    try:
        while True:
            method, arguments = pipe.recv()
            try:
                answer: tuple[bool, Any] = False, getattr(target, method)(*arguments)
            except InputError as error:
                answer = True, error
            except Exception:
                answer = True, traceback.format_exc()
            pipe.send(answer)
    except (EOFError, OSError):
        os._exit(0)
