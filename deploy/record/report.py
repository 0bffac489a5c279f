"""The result of a run, for programs and for people."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deploy.cell import Cell
from deploy.options import RunOptions
from motion.metrics import METRIC_KEYS, over_episodes
from robot.robot import Robot


@dataclass(frozen=True)
class RunReport:
    """outcome: completed, tripped or stopped. fault: the rule that tripped, or why the run could not go on.

    gave_up: whether a run without an operator ended early, though nothing tripped.
    """

    outcome: str
    fault: str | None
    gave_up: bool
    content: dict[str, Any]


@dataclass(frozen=True)
class Ending:
    """How a run ended. by: operator, plan or duration. failure: why the plan gave up, if it did.

    wire: what `WireBackend.report` said before it closed, None where there is no wire.
    """

    by: str
    failure: str | None = None
    wire: Mapping[str, Any] | None = None


def make_report(options: RunOptions, robot: Robot, cell: Cell, ending: Ending) -> RunReport:
    """What the JSON result says of the run that a cell served, and of the actor that performed in it."""
    actor, recorder, fault = cell.performer, cell.recorder, cell.machine.fault
    clips = [(played.name, played.metrics(robot.kinematics)) for played in recorder.performances]
    known = [played for played in recorder.performances if played.known_root]
    early = ending.failure or (None if options.attended else cell.tick.cut_short)
    outcome, reason = "completed", None
    if fault is not None:
        outcome, reason = "tripped", str(fault)
    elif ending.by == "operator" or early is not None:
        outcome, reason = "stopped", early
    content = {
        "policy_sha256": actor.actor.sha256,
        "motion": actor.name,
        "backend": options.backend,
        "peer": options.peer if options.on_wire else None,
        "emulated": options.emulate if options.on_wire else None,
        "sim": options.sim if options.backend == "mujoco" else None,
        "outcome": outcome,
        "fault": reason,
        "fell": any(played.fallen_at is not None for played in known) if known else None,
        "metrics": over_episodes([metrics for _, metrics in clips] or [dict.fromkeys(METRIC_KEYS)]),
        "clips": [{"motion": name, "metrics": over_episodes([metrics])} for name, metrics in clips],
        "heading_error_rad": float(np.mean(recorder.off_rad)) if recorder.off_rad else None,
        "timing": cell.timer.report(),
        "limits": dict(cell.guard.counts),
        "wire": ending.wire,
    }
    return RunReport(outcome, reason, early is not None, _finite(content))


def summary(report: RunReport) -> Sequence[str]:
    """The result in lines for a person."""
    content = report.content
    lines = [f"outcome {report.outcome}" + (f" ({report.fault})" if report.fault else "")]
    means = {name: value and value["mean"] for name, value in content["metrics"].items()}
    known = {name: mean for name, mean in means.items() if mean is not None}
    lines += [f"  {name:22} {value:.4g}" for name, value in known.items()]
    if content["heading_error_rad"] is not None:
        lines.append(f"  {'heading_error_rad':22} {content['heading_error_rad']:.4g}, while steered")
    tick_ms, timing = content["timing"]["tick_ms"], content["timing"]
    if timing["ticks"]:
        text = f"p50 {tick_ms['p50']:.2f}, p99 {tick_ms['p99']:.2f}, max {tick_ms['max']:.2f}"
        lines.append(f"  {timing['ticks']} ticks, ms each: {text}; overruns {timing['overruns']}")
    acted = {rule: count for rule, count in content["limits"].items() if count}
    lines.append("  safety rules, ticks: " + (", ".join(f"{rule} {count}" for rule, count in acted.items()) or "none"))
    return lines


def _finite(value: Any) -> Any:
    """Plain data in which what JSON has no number for is null."""
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
