#!/usr/bin/env -S python3 -P
"""Does the filter know what can be learnt? Its verdicts beside the outcome of short trainings (PBHC Fig. 6).

Of bundled clips and of recordings (--input), as they are and broken on purpose: floating, tilted, teleporting, four
times too fast there and back. Each is processed and trained for --minutes by the default, a rejected one as given. The
outcome is the mean episode length in the clip's length as the training reports it at its end. Ends with 1
where a rejected clip is learnt better than a trackable one. What is trained already in --folder is not trained again.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from core.errors import InputError
from core.processes import available_cores
from core.rotations import quat_from_axis_angle, quat_mul, quat_rotate
from motion.clip import ARRAY_FIELDS, Clip, save_clip
from motion.library import open_motion
from motion.pipeline import ProcessRequest, process
from motion.report.record import TRACKABLE
from robot.robot import load_robot
from train.folder import METRICS_FILE, SUMMARY_FILE

TRAIN = Path(__file__).resolve().parents[1] / "train" / "run.py"
LAST_ITERATIONS = 20


def floating(clip: Clip) -> Clip:
    """Half a metre higher."""
    return replace(clip, root_pos_w=clip.root_pos_w + np.array([0.0, 0.0, 0.5]))


def tilted(clip: Clip) -> Clip:
    """The whole world turned by 25 degrees about the y axis, through the first position on the ground."""
    turn = quat_from_axis_angle(np.array([0.0, 1.0, 0.0]), np.deg2rad(np.full(clip.num_frames, 25.0)))
    origin = clip.root_pos_w[0] * [1.0, 1.0, 0.0]
    pos = quat_rotate(turn, clip.root_pos_w - origin) + origin
    return replace(clip, root_pos_w=pos, root_quat_wxyz=quat_mul(turn, clip.root_quat_wxyz))


def teleporting(clip: Clip) -> Clip:
    """A metre to the side in one frame, every two seconds."""
    leaps = np.arange(clip.num_frames) // round(2.0 * clip.fps)
    return replace(clip, root_pos_w=clip.root_pos_w + np.outer(leaps, [0.0, 1.0, 0.0]))


def over_speed(clip: Clip) -> Clip:
    """Four times as fast, there, back, there and back: as long as it was, for in a short clip half is soon survived."""
    there = np.arange(clip.num_frames)
    back = there[-2::-1]
    frames = np.concatenate([there, back, there[1:], back])
    played = {name: getattr(clip, name)[frames] for name in ARRAY_FIELDS}
    return replace(clip, fps=4.0 * clip.fps, **played)


BUNDLED: dict[str, Callable[[Clip], Clip]] = {
    "taichi": floating,
    "horse_stance_punch": tilted,
    "side_kick": teleporting,
}


@dataclass(frozen=True)
class Row:
    """One clip: the filter's verdict, and what its training came to."""

    name: str
    trackable: bool
    reasons: tuple[str, ...]
    clip: Path
    length_ratio: float = float("nan")
    samples: int = 0


def judged(file: Path, name: str, folder: Path) -> Row:
    """Process a file; the clip to train is the processed one, or the given one where it is rejected."""
    record = process(ProcessRequest(file, name), lambda line: None)
    trackable = record.verdict == TRACKABLE
    clip = record.clip if trackable else open_motion(file, load_robot())
    assert clip is not None
    save_clip(clip, folder / f"{name}.npz")
    return Row(name, trackable, tuple(record.reasons), folder / f"{name}.npz")


def all_rows(inputs: list[Path], folder: Path) -> list[Row]:
    """Verdicts on whole and broken clips."""
    robot, rows = load_robot(), []
    sources = {f.stem: (f, over_speed) for f in inputs} | {name: (Path(name), way) for name, way in BUNDLED.items()}
    for name, (file, way) in sources.items():
        given = folder / f"given_{name}.npz"
        if file.suffix:
            whole = judged(file, name, folder)
        else:
            save_clip(open_motion(name, robot), given)
            whole = judged(given, name, folder)
        broken = f"{name}_{way.__name__}"
        save_clip(way(open_motion(whole.clip, robot)), given.with_stem(f"given_{broken}"))
        rows += [whole, judged(given.with_stem(f"given_{broken}"), broken, folder)]
    return sorted(rows, key=lambda row: not row.trackable)


def trained(row: Row, minutes: float, threads: int) -> Row:
    """Train the row's clip, unless that is done; return the row with the outcome."""
    run = row.clip.with_suffix("")
    if not (run / SUMMARY_FILE).is_file():
        command = [sys.executable, "-P", str(TRAIN), f"motion={row.clip}", f"minutes={minutes}", "iterations=100000"]
        with row.clip.with_suffix(".log").open("w") as log:
            subprocess.run(
                [*command, f"threads={threads}", f"run_dir={run}"], stdout=log, stderr=subprocess.STDOUT, check=True
            )
    entries = [json.loads(line) for line in (run / METRICS_FILE).read_text().splitlines()]
    last = [entry for entry in entries if entry["time/wall_s"] <= 60.0 * minutes][-LAST_ITERATIONS:]
    if not last:
        hint = "remove the folder to train it again"
        raise InputError("no iteration within the minutes", where=run, got=f"{minutes:g} minutes", hint=hint)
    ratio = sum(entry["episode_length_ratio"] for entry in last) / len(last)
    done = replace(row, length_ratio=ratio, samples=last[-1]["samples"])
    print(line_of(done), flush=True)
    return done


def line_of(row: Row) -> str:
    """One line of the table."""
    verdict = "trackable" if row.trackable else "rejected: " + "; ".join(row.reasons)
    return f"{row.name:32} {row.length_ratio:6.2f} {row.samples / 1e6:6.2f} M  {verdict}"


def main() -> int:
    """Print the table, best first. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--input", type=Path, nargs="+", default=[], metavar="FILE", help="recordings or robot clips")
    parser.add_argument("--minutes", type=float, default=10.0, help="of each training (default 10)")
    parser.add_argument("--folder", type=Path, default=Path("runs/filter"), help="receives clips and runs")
    options = parser.parse_args()
    try:
        options.folder.mkdir(parents=True, exist_ok=True)
        rows = all_rows(options.input, options.folder)
    except (InputError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    jobs = available_cores()
    try:
        with ThreadPoolExecutor(jobs) as pool:
            rows = list(pool.map(lambda row: trained(row, options.minutes, threads=1), rows))
    except subprocess.CalledProcessError as error:
        print(f"error: a training ended with {error.returncode}: see {options.folder}/*.log", file=sys.stderr)
        return 1
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"\nepisode length in clip lengths after {options.minutes:g} minutes on one core, {jobs} at a time")
    for row in sorted(rows, key=lambda row: -row.length_ratio):
        print(line_of(row))
    worst = min((row.length_ratio for row in rows if row.trackable), default=float("nan"))
    best = max((row.length_ratio for row in rows if not row.trackable), default=float("nan"))
    print(f"trackable: {worst:.2f} and above; rejected: {best:.2f} and below")
    return 0 if worst > best else 1


if __name__ == "__main__":
    sys.exit(main())
