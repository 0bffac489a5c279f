"""What a run says on the console, without ever waiting for it."""

import contextlib
import os
import queue
import sys
import threading

LINES = 512
END_S = 1.0


class Voice:
    """Lines for standard output and standard error, written in order by a thread of its own.

    A console that is stopped, stalled or gone holds nobody up: at most 512 lines wait, those beyond are lost, and how
    many is said once there is room. An output that fails is given up, which is said on the other one.
    """

    label = ""  # before every line, where each reader must know something

    def __init__(self) -> None:
        self._lines: queue.Queue[tuple[str, bool] | None] = queue.Queue(LINES)
        self._lost = 0
        self._thread = threading.Thread(target=self._write_all, name="voice", daemon=True)
        self._thread.start()

    def say(self, line: str) -> None:
        """To standard output."""
        self._put(line, False)

    def complain(self, line: str) -> None:
        """To standard error."""
        self._put(line, True)

    def close(self) -> bool:
        """Write what is left, for at most a second. False where that did not do: the console takes nothing."""
        with contextlib.suppress(queue.Full):
            self._lines.put(None, timeout=END_S)
            self._thread.join(END_S)
        return not self._thread.is_alive()

    def _put(self, line: str, error: bool) -> None:
        try:
            self._lines.put_nowait((line, error))
        except queue.Full:
            self._lost += 1

    def _write_all(self) -> None:
        while (entry := self._lines.get()) is not None:
            self._write(*entry)
            if self._lost:
                lost, self._lost = self._lost, 0
                self._write(f"{lost} lines lost: the console was too slow", True)

    def _write(self, line: str, error: bool) -> None:
        stream = sys.stderr if error else sys.stdout
        try:
            print(self.label + line.replace("\n", "\n" + self.label), file=stream, flush=True)
        except (OSError, ValueError) as failure:
            _give_up(stream)
            self._put(f"standard {'error' if error else 'output'} is gone ({failure}), going on without it", not error)


def _give_up(stream: object) -> None:
    """From now on it leads nowhere, so that neither a line nor the interpreter's end fails on it again."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())  # type: ignore[attr-defined]
        os.close(nowhere)
