"""How far an evaluation has come, on standard error."""

import sys
import time

from sim2sim.episode import EpisodeScore


class Progress:
    """A line that is rewritten on a terminal; elsewhere one line every tenth of the way."""

    def __init__(self, total: int) -> None:
        self._total, self._done, self._ended_early = total, 0, 0
        self._start_s = time.monotonic()
        self._live = sys.stderr.isatty()

    def __call__(self, job: object, score: EpisodeScore) -> None:
        """One more episode is over."""
        self.count(ended_early=not score.survived)

    def count(self, *, ended_early: bool) -> None:
        """One more episode is over, whatever it was."""
        before = 10 * self._done // self._total
        self._done += 1
        self._ended_early += ended_early
        if self._live or 10 * self._done // self._total > before:
            elapsed_s = time.monotonic() - self._start_s
            left_s = elapsed_s * (self._total - self._done) / self._done
            text = f"episode {self._done}/{self._total}, {self._ended_early} ended early, {left_s:.0f} s left"
            print(
                f"\r\x1b[K{text}" if self._live else text, end="" if self._live else "\n", file=sys.stderr, flush=True
            )

    def end(self) -> None:
        """Leave the line."""
        if self._live:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
