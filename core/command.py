"""How a command ends: with an exit code, and one line for what went wrong."""

import functools
import sys
from collections.abc import Callable
from typing import ParamSpec

from core.errors import InputError

P = ParamSpec("P")
DONE, FAILED, BAD_INPUT, STOPPED = 0, 1, 2, 130


def guarded(main: Callable[P, int]) -> Callable[P, int]:
    """`main` with exit codes for errors: 2 for what a user can cause, 1 for what the machine refuses, 130 on Ctrl-C.

    Each is one line on standard error.
    """

    @functools.wraps(main)
    def run(*args: P.args, **kwargs: P.kwargs) -> int:
        try:
            return main(*args, **kwargs)
        except InputError as error:
            print(f"error: {error}", file=sys.stderr)
            return BAD_INPUT
        except OSError as error:
            print(f"error: {error}", file=sys.stderr)
            return FAILED
        except KeyboardInterrupt:
            print("stopped before the end", file=sys.stderr)
            return STOPPED

    return run
