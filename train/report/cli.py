"""The command `train/report/build`: a run's report anew, with its video."""

from collections.abc import Sequence

from core.arguments import ArgumentParser, path_argument
from core.command import guarded
from train.report.writer import rebuild

FILM_BUDGET_S = 120.0


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Return the exit code: 0 written, 2 unusable input, 1 the report cannot be written."""
    parser = ArgumentParser("train/report/build", description="Write RUN_DIR/report.html anew.", allow_abbrev=False)
    parser.add_argument("run_dir", type=path_argument, metavar="RUN_DIR", help="folder of a run of train/run.py")
    given = parser.parse_args(arguments)
    print(rebuild(given.run_dir.resolve(), FILM_BUDGET_S))
    return 0
