"""The page of a motion's report: report.html, one file with its pictures inside."""

from typing import Any

import numpy as np

from motion.report import figures
from motion.report.figures import Balance
from motion.report.labels import FIGURES, figure_text
from motion.report.record import TRACKABLE, Record, document, verdicts
from motion.report.skeletons import before_and_after, skeleton_of
from motion.report.trace import Trace
from robot.robot import Robot
from view import page as part
from view.filmstrip import filmstrip, png_bytes
from view.stage import Stage

STRIP_PICTURES, STRIP_COLUMNS, STRIP_SIZE_PX = 8, 4, 300


def report_page(record: Record) -> str:
    """The whole page. Raises InputError where this machine cannot draw."""
    kind = "good" if record.verdict == TRACKABLE else "bad"
    body = (
        part.heading(f"Motion: {record.name}", level=1)
        + part.paragraph(record.verdict.capitalize() + ("." if record.reasons == () else ":"), kind)
        + part.bullets(record.reasons)
        + part.heading("The written clip")
        + (figures_table(document(record)) if record.clip else part.paragraph("There is none."))
        + part.heading("The filter")
        + _rules(record)
        + part.heading("Where it comes from")
        + _provenance(record)
        + part.bullets(record.notes)
        + _pictures(record)
    )
    return part.whole_page(f"Motion: {record.name}", body)


def figures_table(content: dict[str, Any]) -> str:
    """The figures of a clip with what they mean, from the content of report.json."""
    rows = [(label, figure_text(content[key]), unit, meaning) for key, (label, unit, meaning) in FIGURES.items()]
    return part.table(rows, numbers=(1,))


def strip_of(trace: Trace, robot: Robot) -> np.ndarray:
    """Pictures of the robot at equal distances through the clip, in two rows: (H,W,3) uint8."""
    frames = np.linspace(0, len(trace.qpos) - 1, STRIP_PICTURES).round().astype(int)
    with Stage(robot, STRIP_SIZE_PX, STRIP_SIZE_PX, scene=trace.scene) as stage:
        return filmstrip([stage.picture(trace.qpos[frame]) for frame in frames], columns=STRIP_COLUMNS)


def _rules(record: Record) -> str:
    """What each rule found in the input and in the written clip, beside its limit."""
    judged = [verdict for verdict in verdicts(record).values() if verdict is not None]
    rows = []
    for findings in zip(*(verdict.findings for verdict in judged), strict=True):
        cells = (f"{'' if one.passed else '✗ '}{one.value:.3g} of {one.limit:.3g}" for one in findings)
        rows.append((findings[0].rule, *cells))
    heads = ("rule", "input", "written clip")[: 1 + len(judged)]
    return part.table(rows, heads, numbers=range(1, 1 + len(judged)))


def _provenance(record: Record) -> str:
    before, clip = record.before, record.clip
    rows = [
        ("input", f"{record.file}, SHA-256 {record.sha256[:16]}…"),
        ("as read", f"{before.num_frames} frames at {before.fps:g} per second, {before.duration_s:.2f} s"),
        ("source", before.source),
        ("licence", before.license),
        ("robot", record.robot.name),
        ("options", ", ".join(f"{key} {value}" for key, value in record.options.items()) or "none"),
    ]
    if clip is not None:
        text = f"{clip.num_frames} frames at {clip.fps:g} per second, {clip.duration_s:.2f} s"
        rows.insert(2, ("as written", f"{text}, SHA-256 of the motion {clip.sha256[:16]}…"))
    return part.table(rows)


def _pictures(record: Record) -> str:
    trace, robot = record.trace, record.robot
    pictures = []
    if trace is not None:
        pictures.append(("The robot", png_bytes(strip_of(trace, robot)), "the written clip at equal distances"))
    rows = [("as read", skeleton_of(record.before, robot))]
    if record.after is not None:
        rows.append(("on the robot", skeleton_of(record.after, robot)))
    pictures.append(("Before and after", before_and_after(rows), "left limbs blue, right limbs orange"))
    pictures.append(("Balance", figures.balance_over_time(_balances(record)), figures.BALANCE_CAPTION))
    if trace is not None:
        pictures += [
            ("Feet", figures.feet_over_time(trace), figures.FEET_CAPTION),
            ("Joint angles", figures.joint_angles(trace, robot), figures.ANGLES_CAPTION),
            ("Joint speeds", figures.joint_speeds(trace, robot), figures.SPEEDS_CAPTION),
        ]
    return "".join(part.heading(title) + part.picture(png, caption) for title, png, caption in pictures)


def _balances(record: Record) -> list[Balance]:
    """Of the input, and of the written clip where there is one."""
    whole = ("The input", record.before, record.input_verdict), ("The written clip", record.clip, record.clip_verdict)
    return [
        Balance(label, motion.fps, verdict.distance_m, verdict.failing_frames)
        for label, motion, verdict in whole
        if motion is not None and verdict is not None
    ]
