"""A lock that a busy thread cannot take again and again while others wait for it."""

import threading


class FairLock:
    """Re-entrant. Whoever waits holds the turnstile, so that the present owner, once it lets go, must let them pass."""

    def __init__(self) -> None:
        self._turnstile, self._lock = threading.Lock(), threading.Lock()
        self._owner = 0
        self._depth = 0

    def __enter__(self) -> None:
        """Wait for it."""
        me = threading.get_ident()
        if self._owner != me:
            with self._turnstile:
                self._lock.acquire()
            self._owner = me
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        """Let go."""
        self._depth -= 1
        if self._depth == 0:
            self._owner = 0
            self._lock.release()
