"""The command `train/report/build`: a run's report anew, with its video."""

import sys
from collections.abc import Sequence

from core.arguments import ArgumentParser, path_argument
from core.errors import InputError
from train.report.writer import rebuild

FILM_BUDGET_S = 120.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit code: 0 written, 2 unusable input, 1 the report cannot be written."""
    parser = ArgumentParser("train/report/build", description="Write RUN_DIR/report.html anew.", allow_abbrev=False)
    parser.add_argument("run_dir", type=path_argument, metavar="RUN_DIR", help="folder of a run of train/run.py")
    try:
        given = parser.parse_args(arguments)
        print(rebuild(given.run_dir.resolve(), FILM_BUDGET_S))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
    return 0
