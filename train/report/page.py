"""The page of a report: one HTML file that needs nothing beside it."""

import base64
import html
from collections.abc import Sequence

import yaml

from train.report import choice
from train.report.choice import JudgedActor
from train.report.figures import Drawing
from train.report.playback import Playback
from train.report.preset import PresetDifference
from train.report.record import TrainingRecord
from train.report.times import time_split, total_s
from train.report.video import Video
from view import page as part

STYLE = """
.chosen { background: #e3f1dd; font-weight: 600; } .wide { overflow-x: auto; font-size: 13px; }
.curves { display: grid; grid-template-columns: repeat(auto-fit, minmax(29rem, 1fr)); gap: 0 1.2rem; }
figure { margin: 0 0 1rem; } h3 { margin: .4rem 0 0; font-size: 15px; }
.bar { background: #6b9bc3; height: .8rem; } td.length { width: 22rem; }
"""


def page(
    record: TrainingRecord, preset: tuple[str, Sequence[PresetDifference]], film: str, drawn: Sequence[Drawing]
) -> str:
    """The whole page. ``film``: the video's section, see :func:`video_section` and :func:`no_video`.

    ``drawn``: the record's curves.
    """
    title = f"Training of {record.motion}: {record.name}"
    body = "".join(
        (
            part.heading(title, level=1) + _head(record),
            f"<h2>The chosen weights</h2>{_chosen(record)}",
            f"<h2>The chosen weights at work</h2>{film}",
            f'<h2>Curves</h2><div class="curves">{"".join(map(_drawing, drawn))}</div>',
            f"<h2>Where the time went</h2>{_times(record)}",
            f"<h2>Configuration</h2>{_configuration(record, *preset)}",
            f"<h2>The machine</h2>{_machine(record)}",
        )
    )
    return part.whole_page(title, body, STYLE)


def video_section(video: Video, playback: Playback) -> str:
    """The video, with what is to be seen in it."""
    iteration = playback.provenance.get("exported_iteration", "unknown")
    ended = f"It falls after {playback.duration_s:.1f} s." if playback.fell else "It does not fall."
    said = (
        f"Left the robot in the training environment, the reference shown through it; right the reference. "
        f"The exported actor (iteration {iteration}), nominal robot, from the first frame, no noise, no pushes; "
        f"true speed, {video.pictures_per_s:.3g} pictures per second. {ended}"
    )
    errors = ", ".join(f"{_words(name)} {value:.1f}" for name, value in playback.errors.items())
    means = f"Means over this episode: {html.escape(errors)}."
    return part.video(video.mp4) + f'<p class="small">{html.escape(said)}<br>{means}</p>'


def no_video(reason: str) -> str:
    """Why there is no video."""
    return part.paragraph(f"No video: {reason}")


def _head(record: TrainingRecord) -> str:
    last = record.rows[-1] if record.rows else {}
    wall_s = last.get("time/wall_s") or 0.0
    rows = [
        ("outcome", f"{record.outcome} after {last.get('iteration', 0)} iterations"),
        ("samples", f"{last.get('samples', 0) / 1e6:.2f} million in {_duration(wall_s)}"),
        ("motion", str(record.document["motion"] or record.document["motions"])),
        ("seed", str(record.document.get("seed", "unknown"))),
    ]
    if record.dumps:
        rows.append(("NaN dumps", ", ".join(record.dumps)))
    if record.summary:
        rows.append(("actor", f"{record.summary['actor']}, SHA-256 {record.summary['actor_sha256'][:16]}…"))
        rows.append(("code", str(record.summary["code"])))
    return part.table(rows)


def _chosen(record: TrainingRecord) -> str:
    judged = record.evaluations
    paragraphs = [choice.explain(judged), choice.RULE] if judged else [choice.explain(judged)]
    exported = record.summary.get("exported_iteration")
    said = "".join(map(part.paragraph, paragraphs))
    if exported is not None and not any(one.iteration == exported for one in judged):
        said += f"<p>Exported: the weights of iteration {exported}.</p>"
    return said + (_judgements(judged, choice.best(judged)) if judged else "")


def _judgements(judged: Sequence[JudgedActor], chosen: JudgedActor | None) -> str:
    names = list(dict.fromkeys(name for one in judged for name in one.figures))
    heads = "".join(f'<th class="number">{html.escape(_words(name))}</th>' for name in names)
    rows = []
    for one in judged:
        cells = "".join(f'<td class="number">{_figure(name, one.figures.get(name))}</td>' for name in names)
        mark = ' class="chosen"' if one is chosen else ""
        label = f"{one.iteration} ← chosen" if one is chosen else str(one.iteration)
        rows.append(f"<tr{mark}><td>{label}</td>{cells}</tr>")
    return f'<div class="wide"><table><tr><th>iteration</th>{heads}</tr>{"".join(rows)}</table></div>'


def _drawing(drawing: Drawing) -> str:
    source = base64.b64encode(drawing.svg).decode()
    title, caption = html.escape(drawing.title), html.escape(drawing.caption)
    return (
        f'<figure><h3>{title}</h3><img alt="{title}" src="data:image/svg+xml;base64,{source}">'
        f'<figcaption class="small">{caption}</figcaption></figure>'
    )


def _times(record: TrainingRecord) -> str:
    parts = time_split(record.rows)
    total = total_s(parts)
    if not total:
        return "<p>No iteration yet.</p>"
    rows = []
    for one in parts:
        share = one.seconds / total
        rows.append(
            f'<tr><td>{html.escape(one.title)}</td><td class="number">{_duration(one.seconds)}</td>'
            f'<td class="number">{100 * share:.1f} %</td>'
            f'<td class="length"><div class="bar" style="width: {100 * share:.1f}%"></div></td></tr>'
        )
    return f"<table>{''.join(rows)}</table>"


def _configuration(record: TrainingRecord, preset: str, found: Sequence[PresetDifference]) -> str:
    whole = html.escape(yaml.safe_dump(dict(record.document), sort_keys=False, allow_unicode=True))
    details = f"<details><summary>Whole configuration</summary><pre>{whole}</pre></details>"
    if not preset:
        return f"<p>No preset to compare with.</p>{details}"
    if not found:
        return f"<p>As <code>train={html.escape(preset)}</code>, without a difference.</p>{details}"
    said = f"Differences from <code>train={html.escape(preset)}</code>, the preset with the fewest:"
    table = part.table([(one.key, one.preset, one.here) for one in found], ("key", "preset", "this run"))
    return f"<p>{said}</p>{table}{details}"


def _machine(record: TrainingRecord) -> str:
    if not record.machine:
        return "<p>Not recorded: the run's folder has no summary of it.</p>"
    return part.table(record.machine.items())


def _words(name: str) -> str:
    for suffix in ("_mm", "_mrad"):
        if name.endswith(suffix):
            return f"{name.removesuffix(suffix)} [{suffix[1:]}]".replace("_", " ")
    return name.replace("_", " ")


def _figure(name: str, value: float | None) -> str:
    if value is None:
        return "not finite"
    return f"{100 * value:.1f} %" if name.endswith("falls") else f"{value:.1f}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
