"""The command `motion/check`: what keeps clips from being performed."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from core.arguments import ArgumentParser, positive_argument
from core.command import BAD_INPUT, DONE, FAILED, guarded
from core.config import errors_in
from core.errors import InputError
from core.text_table import text_table
from motion.filter import Verdict, judge
from motion.library import open_motion
from motion.report.labels import FIGURES, figure_text
from motion.report.record import NOT_TRACKABLE, TRACKABLE, figures, residual_of
from motion.report.trace import trace_clip
from motion.report.warnings import warnings_of
from robot.robot import Robot, load_robot

UNITS = ("mm", "Nm", "N", "s")  # that a column names: the others count


@dataclass(frozen=True)
class ClipFinding:
    """What is wrong with one clip; `figures` by key of report.json."""

    name: str
    verdict: Verdict
    figures: dict[str, Any]


def build_parser() -> ArgumentParser:
    """The options, as people script against them."""
    parser = ArgumentParser(
        "motion/check",
        description="Print the physical violations of clips. Ends with 1 when one of them is not trackable.",
        allow_abbrev=False,
    )
    parser.add_argument("clips", nargs="+", metavar="CLIP", help="bundled name, or a file of a robot's motion")
    parser.add_argument("--robot", default="g1_23dof", metavar="NAME|FILE", help="whose motion (default g1_23dof)")
    parser.add_argument(
        "--fps", type=positive_argument, metavar="F", help="frame rate of the files, also against what they say"
    )
    return parser


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Check. Returns the exit code: 0 all trackable, 1 one is not, 2 bad input."""
    options = build_parser().parse_args(arguments)
    robot = load_robot(options.robot)
    findings, errors = [], []
    for name in options.clips:
        try:
            findings.append(find(name, robot, options.fps))
        except InputError as error:
            errors.append(f"error: {error}")
    if findings:
        print(report(findings), flush=True)
    for line in errors:
        print(line, file=sys.stderr)
    if errors:
        return BAD_INPUT
    return DONE if all(finding.verdict.stable for finding in findings) else FAILED


def find(name_or_file: str, robot: Robot, fps: float | None = None) -> ClipFinding:
    """Judge one clip. Raises InputError when it cannot be read."""
    clip = open_motion(name_or_file, robot, csv_fps=fps)
    verdict = judge((clip, robot))
    with errors_in(name_or_file):
        residual = residual_of(clip, robot)
    return ClipFinding(name_or_file, verdict, figures(trace_clip(clip, robot), verdict, residual))


def report(findings: Sequence[ClipFinding]) -> str:
    """A table with a line a clip, and under it why clips are not trackable, warnings, and collisions."""
    heads = ("clip", "verdict", *(f"{label} {unit}" if unit in UNITS else label for label, unit, _ in FIGURES.values()))
    rows = []
    for finding in findings:
        verdict = TRACKABLE if finding.verdict.stable else NOT_TRACKABLE
        rows.append((finding.name, verdict, *(_cell(finding.figures[key]) for key in FIGURES)))
    said = [f"{finding.name}: {reason}" for finding in findings for reason in finding.verdict.reasons]
    for finding in findings:
        said += [f"{finding.name}: {warning}" for warning in warnings_of(finding.figures)]
        pairs = finding.figures["self_collisions"].items()
        said += [f"{finding.name}: {pair} inside each other in {frames} frames" for pair, frames in pairs]
    return "\n".join([text_table(heads, rows, right=range(2, len(heads))), *said])


def _cell(value: Any) -> str:
    return str(sum(value.values())) if isinstance(value, dict) else figure_text(value)
