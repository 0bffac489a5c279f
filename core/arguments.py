"""Command lines whose errors are one line, like every other error that a user can cause."""

import argparse
import math
from pathlib import Path
from typing import NoReturn

from core.errors import InputError


class ArgumentParser(argparse.ArgumentParser):
    """argparse that raises InputError where the original prints its usage and ends the process."""

    def error(self, message: str) -> NoReturn:
        """Raise InputError."""
        raise InputError(message, hint=f"see {self.prog} --help")


def path_argument(text: str) -> Path:
    """A path as an option's value. The empty text, most often an unset variable of a script, is none."""
    if not text:
        raise argparse.ArgumentTypeError("got nothing, expected a path")
    return Path(text)


def number_argument(text: str) -> float:
    """A finite number from 0 up as an option's value."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"got {text}, expected a finite number from 0 up")
    return value


def positive_argument(text: str) -> float:
    """A finite number above 0 as an option's value."""
    value = number_argument(text)
    if value == 0.0:
        raise argparse.ArgumentTypeError(f"got {text}, expected a number above 0")
    return value


def count_argument(text: str) -> int:
    """A whole number from 0 up as an option's value."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"got {text}, expected a whole number from 0 up")
    return int(text)


def positive_count_argument(text: str) -> int:
    """A whole number from 1 up as an option's value."""
    value = count_argument(text)
    if value == 0:
        raise argparse.ArgumentTypeError(f"got {text}, expected a whole number from 1 up")
    return value
