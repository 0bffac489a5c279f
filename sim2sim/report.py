"""One HTML file that holds an evaluation: scores with their definitions, plots, pictures. Needs nothing beside it."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from core.files import replacing
from sim2sim import plots
from sim2sim.definitions import AVERAGING
from sim2sim.evaluation import Evaluation, Run
from sim2sim.table import score_rows
from sim2sim.video import open_stages, strip
from view import page as part


@dataclass(frozen=True)
class Picture:
    """A PNG with its caption."""

    caption: str
    png: bytes


def write_report(folder: Path, evaluation: Evaluation, meshes: Path | None = None) -> None:
    """Write `report.html`, complete or not at all, into `folder`, which is made if need be.

    meshes: folder of the maker's, see world.model.
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
    scenes = {run.name: run.scene for run in evaluation.runs}
    with ExitStack() as stack:
        stages = open_stages(evaluation, meshes, stack)
        drawn = {name: strip(stages[scenes[name]], episodes[0]) for name, episodes in runs.items()}
    strips = [
        Picture(f"{name}: first episode, the reference shown through", plots.picture_png(pixels))
        for name, pixels in drawn.items()
    ]
    return [
        Picture("Along the clip", plots.error_over_time(runs, period_s)),
        Picture("Survival", plots.survival_over_time(everyone, period_s)),
        *strips,
        Picture("Bodies", plots.error_per_body(runs, robot.tracked_names)),
        Picture("Joints", plots.error_per_joint(runs, robot.joint_names)),
    ]


def _page(evaluation: Evaluation, pictures: Sequence[Picture]) -> str:
    title = "Evaluation: " + ", ".join(run.name for run in evaluation.runs)
    body = (
        part.heading(title, level=1)
        + part.table(evaluation.request.described().items(), named=True)
        + _scores(evaluation.runs)
        + "".join(map(part.paragraph, evaluation.remarks()))
        + "".join(part.heading(one.caption) + part.image(one.png, one.caption) for one in pictures)
    )
    return part.whole_page(title, body)


def _scores(runs: Sequence[Run]) -> str:
    documents = [run.document for run in runs]
    rows = [
        ("actor", *(run.name for run in runs), "", "name or file"),
        ("SHA-256", *(found["policy_sha256"][:16] for found in documents), "", "of the file, its first 16 digits"),
        ("motion", *(found["motion"] for found in documents), "", ""),
        *score_rows(documents),
    ]
    return part.table(rows, numbers=range(1, 1 + len(runs)), named=True) + part.paragraph(AVERAGING, "small")
