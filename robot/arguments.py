"""Command lines whose errors are one line, like every other error that a user can cause."""

import argparse
from pathlib import Path
from typing import NoReturn

from robot.errors import InputError


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
