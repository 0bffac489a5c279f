"""All that is known of one processed input, and its report.json."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from motion.clip import Clip
from motion.filter import Verdict
from motion.human.motion import HumanMotion
from motion.reference import build_reference
from motion.report.trace import Trace, trace_clip
from motion.report.warnings import warnings_of
from motion.residual_wrench import Residual, demand_of, residual_wrench
from motion.retarget.clean import Change
from robot.robot import Robot

CREATED_BY = "kata motion/process"
TRACKABLE, NOT_TRACKABLE = "trackable", "not trackable"


@dataclass(frozen=True, eq=False)
class Record:
    """One processed input.

    Attributes:
        name: of the clip.
        file: name of the input, without its folder; sha256: of its bytes.
        options: how it was processed, plain values; settings_sha256: of the files with the settings
            and the robot.
        notes: what was assumed or detected on the way.
        before: the motion as it was read, cut to the wanted span; its verdict: input_verdict.
        after: the same span on the robot; change: how far that is from a robot's motion as read, None for a person's.
        clip: as it is written, with its ends; clip_verdict: of that.
        failure: why there is no clip; None where there is one.
    """

    name: str
    robot: Robot
    file: str
    sha256: str
    options: Mapping[str, Any]
    settings_sha256: str
    notes: tuple[str, ...]
    before: HumanMotion | Clip
    input_verdict: Verdict
    after: Clip | None = None
    change: Change | None = None
    clip: Clip | None = None
    clip_verdict: Verdict | None = None
    failure: str | None = None

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the motion is not trackable, and warnings about the clip, which a trackable one may have as well."""
        found = [f"input: {reason}" for reason in self.input_verdict.reasons]
        if self.clip_verdict is not None:
            found += [f"clip: {reason}" for reason in self.clip_verdict.reasons]
        told = figures(self.trace, self.clip_verdict, self.residual)
        found += [f"clip: {warning}" for warning in warnings_of(told)]
        if self.failure is not None:
            found.append(f"no clip: {self.failure}")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """TRACKABLE or NOT_TRACKABLE."""
        return TRACKABLE if all(one is not None and one.stable for one in verdicts(self).values()) else NOT_TRACKABLE

    @cached_property
    def trace(self) -> Trace | None:
        """The written clip frame by frame."""
        return None if self.clip is None else trace_clip(self.clip, self.robot)

    @cached_property
    def residual(self) -> Residual | None:
        """What the ground cannot supply of the written clip."""
        return None if self.clip is None else residual_of(self.clip, self.robot)


def document(record: Record) -> dict[str, Any]:
    """The content of report.json. Figures are of the written clip, null where there is none."""
    return {
        "verdict": record.verdict,
        "reasons": list(record.reasons),
        **figures(record.trace, record.clip_verdict, record.residual),
        "largest_change": _change(record.change),
        "failing_frames": _failing_frames(record),
        "rules": {name: _rules(verdict) for name, verdict in verdicts(record).items()},
        "notes": list(record.notes),
        "input": {
            "file": record.file,
            "sha256": record.sha256,
            "fps": record.before.fps,
            "frames": record.before.num_frames,
            "duration_s": record.before.duration_s,
        },
        "clip": _clip_facts(record.clip),
        "robot": record.robot.name,
        "options": dict(record.options),
        "settings_sha256": record.settings_sha256,
        "created_by": CREATED_BY,
    }


def residual_of(clip: Clip, robot: Robot) -> Residual:
    """What the ground cannot supply of `clip`. Raises InputError when it is shorter than a control period."""
    return residual_wrench(demand_of(robot, build_reference(clip, robot)))


def figures(trace: Trace | None, verdict: Verdict | None, residual: Residual | None) -> dict[str, Any]:
    """Worst frame or worst contact in mm, counts of frames x joints, frames a colliding pair, the worst half second of
    the residual wrench; None without a clip."""
    if trace is None or verdict is None or residual is None:
        keys = ("penetration_mm", "floating_mm", "sliding_mm", "com_cop_mm", "airborne_frames")
        counts = ("limit_violations", "speed_violations", "self_collisions")
        return dict.fromkeys((*keys, *counts, "residual_torque_nm", "residual_force_n", "residual_at_s"))
    supported = np.isfinite(verdict.distance_m)
    worst_m = float(verdict.distance_m[supported].max()) if supported.any() else None
    return {
        "penetration_mm": _mm(float(trace.penetration_m.max())),
        "floating_mm": _mm(trace.float_m),
        "sliding_mm": _mm(trace.max_slide_m),
        "com_cop_mm": None if worst_m is None else _mm(worst_m),
        "airborne_frames": int((~supported).sum()),
        "limit_violations": int(trace.position_violations.sum()),
        "speed_violations": int(trace.speed_violations.sum()),
        "self_collisions": trace.self_collisions,
        "residual_torque_nm": round(float(residual.torque_nm[residual.worst]), 1),
        "residual_force_n": round(float(residual.force_n[residual.worst]), 1),
        "residual_at_s": float(residual.start_s[residual.worst]),
    }


def json_text(content: Mapping[str, Any]) -> str:
    """JSON with one entry of the outermost level a line. Raises ValueError on numbers that JSON does not have."""
    lines = [f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}" for key, value in content.items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def verdicts(record: Record) -> dict[str, Verdict | None]:
    """Of the input and of the written clip, None where there is none."""
    return {"input": record.input_verdict, "clip": record.clip_verdict}


def _failing_frames(record: Record) -> dict[str, list[int] | None]:
    return {name: None if one is None else one.failing_frames.tolist() for name, one in verdicts(record).items()}


def _rules(verdict: Verdict | None) -> dict[str, dict[str, Any]] | None:
    """What each rule of the filter found."""
    if verdict is None:
        return None
    return {
        finding.rule: {"passed": finding.passed, "value": _finite(finding.value), "limit": finding.limit}
        for finding in verdict.findings
    }


def _change(change: Change | None) -> dict[str, Any] | None:
    if change is None:
        return None
    turns = {"root_rad": round(change.root_rad, 4), "joint_rad": round(change.joint_rad, 4), "joint": change.joint}
    return {"root_mm": _mm(change.root_m), **turns}


def _clip_facts(clip: Clip | None) -> dict[str, Any] | None:
    if clip is None:
        return None
    facts = {"fps": clip.fps, "frames": clip.num_frames, "duration_s": clip.duration_s, "sha256": clip.sha256}
    return facts | {"source": clip.source, "license": clip.license}


def _mm(length_m: float) -> float:
    return round(1e3 * length_m, 3)


def _finite(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None
