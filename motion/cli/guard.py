"""What every command here does with errors."""

import sys
from collections.abc import Callable

from core.errors import InputError

NOT_TRACKABLE_CODE, BAD_INPUT_CODE = 1, 2


def guarded(run: Callable[[], int]) -> int:
    """The exit code of `run`: 2 and one line for what a user can cause, 1 for what the machine refuses, 0 on Ctrl-C."""
    try:
        return run()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return BAD_INPUT_CODE
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped before the end", file=sys.stderr)
        return 0
