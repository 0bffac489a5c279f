"""One HTML file that holds an evaluation: scores with their definitions, plots, pictures. Needs nothing beside it."""

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from deploy.outputs import replacing
from sim2sim import plots
from sim2sim.definitions import AVERAGING, SCORES, SURVIVAL
from sim2sim.evaluation import Evaluation, Run
from sim2sim.table import format_value
from sim2sim.video import Stage

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { padding: .25rem .8rem; border-bottom: 1px solid #ddd; text-align: left; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; } img { max-width: 100%; }
code { word-break: break-all; } .small { color: #555; font-size: 13px; }
"""


@dataclass(frozen=True)
class Picture:
    """A PNG with its caption."""

    caption: str
    png: bytes


def write_report(folder: Path, evaluation: Evaluation, meshes: Path | None = None) -> None:
    """Write `report.html`, complete or not at all, into `folder`, which is made if need be.

    meshes: folder of the maker's, see robot.mjcf.
    """
    page = _page(evaluation, _pictures(evaluation, meshes))
    folder.mkdir(exist_ok=True)
    with replacing(folder / "report.html") as unfinished:
        unfinished.write_text(page, encoding="utf-8")


def _pictures(evaluation: Evaluation, meshes: Path | None) -> list[Picture]:
    everyone = {run.name: run.episodes for run in evaluation.runs}
    runs = {name: [episode for episode in episodes if len(episode.qpos)] for name, episodes in everyone.items()}
    runs = {name: episodes for name, episodes in runs.items() if episodes}
    if not runs:
        return []
    period_s, robot = evaluation.player.period_s, evaluation.player.robot
    with Stage(robot, meshes) as stage:
        strips = [
            Picture(f"{name}: first episode, the reference shown through", plots.picture_png(stage.strip(episodes[0])))
            for name, episodes in runs.items()
        ]
    return [
        Picture("Along the clip", plots.error_over_time(runs, period_s)),
        Picture("Survival", plots.survival_over_time(everyone, period_s)),
        *strips,
        Picture("Bodies", plots.error_per_body(runs, robot.tracked_names)),
        Picture("Joints", plots.error_per_joint(runs, robot.joint_names)),
    ]


def _page(evaluation: Evaluation, pictures: Sequence[Picture]) -> str:
    title = html.escape("Evaluation: " + ", ".join(run.name for run in evaluation.runs))
    conditions = evaluation.request.described().items()
    asked = "".join(f"<tr><th>{html.escape(key)}</th><td>{html.escape(value)}</td></tr>" for key, value in conditions)
    remarks = "".join(f"<p>{html.escape(remark)}</p>" for remark in evaluation.remarks())
    figures = "".join(
        f'<h2>{html.escape(picture.caption)}</h2><img alt="{html.escape(picture.caption)}" '
        f'src="data:image/png;base64,{base64.b64encode(picture.png).decode()}">'
        for picture in pictures
    )
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{STYLE}</style></head><body><h1>{title}</h1><table>{asked}</table>"
        f"{_scores(evaluation.runs)}{remarks}{figures}</body></html>\n"
    )


def _scores(runs: Sequence[Run]) -> str:
    documents = [run.document for run in runs]
    survival_meaning = SURVIVAL[documents[0]["sim"]]
    rows = [
        ("actor", [run.name for run in runs], "", "name or file"),
        ("SHA-256", [document["policy_sha256"][:16] for document in documents], "", "of the file, its first 16 digits"),
        ("motion", [document["motion"] for document in documents], "", ""),
        ("survival", [f"{100 * document['survival_rate']:.1f}" for document in documents], "%", survival_meaning),
    ]
    for score in SCORES:
        values = [format_value(document["metrics"][score.key]) for document in documents]
        rows.append((score.label, values, score.unit, score.meaning))
    return f'<table>{"".join(_row(*row) for row in rows)}</table><p class="small">{html.escape(AVERAGING)}</p>'


def _row(label: str, values: Sequence[str], unit: str, meaning: str) -> str:
    cells = "".join(f'<td class="number">{html.escape(value)}</td>' for value in values)
    words = f"<td>{html.escape(unit)}</td><td>{html.escape(meaning)}</td>"
    return f"<tr><th>{html.escape(label)}</th>{cells}{words}</tr>"
