"""What a process of the wire says on standard error can never make it wait."""

import contextlib
import os
import select
import threading

CHUNK = 65_536
LAST_WORDS_S = 0.2
STDERR = 2


class Saying:
    """From `start` on descriptor 2 is a pipe of our own, which a thread passes on; libraries in C write there too.

    A pipe of which nobody reads, or a stopped terminal, stops that thread alone; what does not fit then is lost.
    `last_words` gives the thread 0.2 s to pass on what is left.
    """

    def start(self) -> None:
        """Begin. For the main thread of a process, once."""
        self._heard, written = os.pipe()
        self._real = os.dup(STDERR)
        os.set_blocking(written, False)
        os.dup2(written, STDERR)
        os.close(written)
        self._thread = threading.Thread(target=self._pass_on, name="standard error", daemon=True)
        self._thread.start()

    def last_words(self) -> None:
        """Nothing more is said; before the process ends. Never waits for longer."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, STDERR)
        self._thread.join(LAST_WORDS_S)

    def _pass_on(self) -> None:
        with contextlib.suppress(OSError):  # the console may have gone with the loop
            while data := os.read(self._heard, CHUNK):
                os.write(self._real, data)


def say(line: str) -> None:
    """One line on standard error; lost where nobody can take it now."""
    with contextlib.suppress(OSError):
        if select.select([], [STDERR], [], 0.0)[1]:
            os.write(STDERR, f"{line}\n".encode())
