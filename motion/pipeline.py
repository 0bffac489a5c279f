"""From a recorded motion to a clip that the robot can follow: the steps of the paper's section 3.1, in its order."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from core.config import config_file, errors_in
from core.errors import InputError
from motion.clip import Clip
from motion.contact import contact_of, staying_contact
from motion.filter import Verdict, judge
from motion.finish import loop_clip, mirror_clip, with_default_ends
from motion.human.correct import correct_height
from motion.human.motion import HumanMotion
from motion.human.segment import segment_motion
from motion.read import read_motion
from motion.report.record import CREATED_BY, Record
from motion.resample import resample
from motion.retarget.clean import Change, clean_robot_motion, largest_change
from motion.retarget.retarget import retarget
from motion.retarget.settings import SETTINGS, RetargetSettings, load_settings
from motion.settings import PROCESS, read_section
from robot.robot import Robot, load_robot
from world.scene import FLAT

Say = Callable[[str], None]


@dataclass(frozen=True)
class ProcessRequest:
    """What to make of one file; see the options of motion/process. Times in s of the recording."""

    file: Path
    name: str
    robot: str = "g1_23dof"
    fps: float | None = None
    start_s: float | None = None
    end_s: float | None = None
    loop: bool = False
    mirror: bool = False
    skeleton: Path | None = None
    unit: str | None = None
    up: str | None = None
    body_models: Path | None = None

    def options(self) -> dict[str, Any]:
        """How to process, as far as given, as plain values; of files their names without folders."""
        given = {field.name: getattr(self, field.name) for field in fields(self)[3:]}
        return {key: value.name if isinstance(value, Path) else value for key, value in given.items() if value}

    def settings_sha256(self) -> str:
        """Of the files with the settings of all steps, of the robot's, and of the skeleton and body models given."""
        robot = load_robot(self.robot)
        files = [PROCESS, SETTINGS / f"{robot.name}.yaml", config_file("robot", self.robot), robot.mjcf_path]
        files += [] if self.skeleton is None else [self.skeleton]
        files += [] if self.body_models is None else sorted(self.body_models.rglob("*"))
        digest = hashlib.sha256()
        for path in filter(Path.is_file, files):
            with path.open("rb") as file:
                while part := file.read(2**20):
                    digest.update(part)
        return digest.hexdigest()


@dataclass(frozen=True)
class OutputSettings:
    """Section `output` of configs/motion/process.yaml; see there."""

    max_fps: float


def process(request: ProcessRequest, say: Say) -> Record:
    """All steps but the report; `say` hears a line of each.

    A motion that the filter rejects goes on as far as it can, so that its report shows what the robot would do. Raises
    InputError: the file or an option is unusable, or a motion that passed the filter cannot be finished as asked.
    """
    robot = load_robot(request.robot)
    settings, output = load_settings(robot), read_section(OutputSettings, "output")
    before, sha256 = _read(request, robot), _digest(request.file)
    say(f"read: {before.num_frames} frames at {before.fps:g} per second, {before.duration_s:.2f} s")
    for note in notes_of(before):
        say(f"  {note}")
    verdict = judge(before if isinstance(before, HumanMotion) else (before, robot))
    say(f"filter: {_judged(verdict)}")
    record = Record(
        name=request.name,
        robot=robot,
        file=request.file.name,
        sha256=sha256,
        options=request.options(),
        settings_sha256=request.settings_sha256(),
        notes=notes_of(before),
        before=before,
        input_verdict=verdict,
    )
    try:
        after, change, notes = _on_the_robot(before, robot, settings, say)
        clip = _finished(after, robot, request, output)
    except InputError as error:
        if verdict.stable:
            raise InputError(str(error), where=request.file) from error
        return replace(record, failure=str(error))
    own = judge((clip, robot))
    say(f"finish: {clip.num_frames} frames at {clip.fps:g} per second, {clip.duration_s:.2f} s, {_judged(own)}")
    record = replace(record, notes=notes, after=after, change=change, clip=clip, clip_verdict=own)
    say(f"forces: {record.residual}")
    return record


def notes_of(motion: HumanMotion | Clip) -> tuple[str, ...]:
    """What was assumed or detected while reading."""
    return motion.notes if isinstance(motion, HumanMotion) else (f"A robot's motion: {motion.created_by}.",)


def _read(request: ProcessRequest, robot: Robot) -> HumanMotion | Clip:
    motion = read_motion(
        request.file,
        fps=request.fps,
        robot=robot,
        skeleton=request.skeleton,
        unit=request.unit,
        up=request.up,
        body_models=request.body_models,
    )
    if isinstance(motion, Clip) and motion.scene != FLAT:
        raise InputError("has a scene", where=request.file, expected="a motion on flat ground at height 0")
    if request.start_s is None and request.end_s is None:
        return motion
    with errors_in(request.file):
        return segment_motion(motion, request.start_s or 0.0, request.end_s)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _on_the_robot(
    before: HumanMotion | Clip, robot: Robot, settings: RetargetSettings, say: Say
) -> tuple[Clip, Change | None, tuple[str, ...]]:
    """The motion frame by frame on the robot, how far a robot's own was changed, and all notes so far."""
    if isinstance(before, Clip):
        contact = staying_contact((before, robot), before.contact)
        say(f"contact: {_stood(before.contact, contact)}")
        clip = clean_robot_motion(replace(before, contact=contact), robot, settings)
        change = largest_change(before, clip, robot)
        say(f"correct: {_changed(change)}")
        return clip, change, (*notes_of(before), _changed(change))
    found = contact_of(before)
    contact = staying_contact(before, found)
    say(f"contact: {_stood(found, contact)}")
    corrected = correct_height(before, contact)
    say(f"correct: {corrected.notes[-1]}")
    say(f"retarget: onto {robot.name}")
    return retarget(corrected, contact, robot, settings), None, corrected.notes


def _changed(change: Change) -> str:
    turns = f"{np.rad2deg(change.root_rad):.1f} degrees, a joint by {np.rad2deg(change.joint_rad):.1f} ({change.joint})"
    return f"Height, limits and feet were corrected: the root by up to {1e3 * change.root_m:.0f} mm and {turns}."


def _finished(clip: Clip, robot: Robot, request: ProcessRequest, output: OutputSettings) -> Clip:
    """The clip as it is written. A loop has no ends in the default pose: it would pass through them every time."""
    clip = replace(resample(clip, min(clip.fps, output.max_fps)), created_by=CREATED_BY)
    if request.mirror:
        clip = mirror_clip(clip, robot)
    return loop_clip(clip, robot) if request.loop else with_default_ends(clip, robot)


def _judged(verdict: Verdict) -> str:
    return "passed" if verdict.stable else "not passed"


def _stood(found: np.ndarray, contact: np.ndarray) -> str:
    """How much the feet stand, and how much of the contact found was none."""
    left, right = 100.0 * (contact > 0.5).mean(axis=0)
    travels = 100.0 * ((found > 0.5) & (contact <= 0.5)).any(axis=1).mean()
    cut = f"; cut in {travels:.0f} %, where a foot travels" if travels else ""
    return f"left foot in {left:.0f} % of the frames, right foot in {right:.0f} %{cut}"
