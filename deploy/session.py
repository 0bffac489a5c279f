"""One run from options to result: load, preflight, loop, close, score."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.actor_run import ActorRun
from deploy.actors import check_same_period, load_run
from deploy.console import Console
from deploy.episode import Start, place_at_reference
from deploy.log import McapLog
from deploy.loop import Loop, Observer, Plan
from deploy.operator import Keyboard, RequestSource, StopSignals
from deploy.options import RunOptions
from deploy.preflight import require, run_preflight, table
from deploy.realtime import no_garbage_collection, realtime
from deploy.recorder import Recorder
from deploy.safety.guard import Guard
from deploy.sequence import BandRelease, OnlyTheClip, Unattended
from deploy.settings import DeploySettings, load_settings
from deploy.states import StateMachine
from deploy.tick import Tick
from deploy.timing import PhaseTimer
from hal.backend import Backend, Placeable
from hal.clock import Clock, MonotonicClock, SimulatedClock
from hal.mujoco import MujocoBackend
from hal.open import open_backend
from hal.sim_options import SimOptions, load_sim_options
from hal.types import DeviceInfo
from motion.metrics import METRIC_KEYS, over_episodes
from robot.kinematics import Kinematics
from robot.mjcf import check_meshes, compile_model
from robot.robot import Robot, load_robot

if TYPE_CHECKING:
    from deploy.film import Film


@dataclass(frozen=True)
class RunReport:
    """outcome: completed, tripped or stopped. fault: the rule that tripped, or why the run could not go on.

    gave_up: whether the unattended sequence stopped because a step's conditions never came.
    """

    outcome: str
    fault: str | None
    gave_up: bool
    content: dict[str, Any]


@dataclass(frozen=True)
class _Setup:
    robot: Robot
    settings: DeploySettings
    sim: SimOptions
    actors: tuple[ActorRun, ...]
    stand: ActorRun | None
    period_s: float
    clock: Clock
    backend: Backend

    @property
    def runs(self) -> list[ActorRun]:
        return [*self.actors, *([] if self.stand is None else [self.stand])]


@dataclass(frozen=True)
class _Performer:
    """What remembers and decides during one run."""

    machine: StateMachine
    guard: Guard
    recorder: Recorder
    timer: PhaseTimer


def run_session(options: RunOptions, signals: StopSignals) -> RunReport:
    """Do what the options ask. Raises InputError before anything is opened, DeviceError where the device refuses."""
    options.check()
    setup = _prepare(options)
    recorder = Recorder()
    film = None if options.video is None else _new_film(options.video, recorder, setup)
    guard = Guard(
        setup.robot,
        setup.settings,
        setup.period_s,
        report_only=options.backend == "mujoco" and setup.sim.report_only,
    )
    machine = StateMachine(setup.robot, setup.stand, setup.actors, setup.settings, setup.period_s)
    performer = _Performer(machine, guard, recorder, PhaseTimer())
    with contextlib.closing(setup.backend):
        _preflight(options, setup, setup.backend.open())
        ended_by, failure = ("plan", None) if options.dry_run else _perform(options, setup, performer, film, signals)
    report = _report(options, setup, performer, ended_by, failure)
    if film is not None and not options.dry_run:
        model = compile_model(setup.robot, timestep_s=setup.period_s, meshes=options.meshes)
        if not film.draw(model, lambda: signals.raised):
            print(f"stopped: {options.video} was not drawn", flush=True)
    return report


def _prepare(options: RunOptions) -> _Setup:
    """Load everything that a user may have got wrong."""
    robot, settings, sim = load_robot(options.robot), load_settings(options.settings), load_sim_options(options.sim)
    if options.meshes is not None:
        check_meshes(robot, options.meshes)
    actors = tuple(load_run(policy, options.motion, robot, settings.entry) for policy in options.policies)
    stand = load_run(options.stand, None, robot, settings.entry) if options.start is Start.STAND else None
    period_s = check_same_period([*actors, *([] if stand is None else [stand])])
    clock: Clock = MonotonicClock() if options.on_wall_clock else SimulatedClock()
    backend = open_backend(
        options.backend,
        robot,
        clock,
        control_period_s=period_s,
        sim=sim,
        sim_model=options.sim_model,
        band=options.start is Start.STAND,
        meshes=options.meshes if options.viewer else None,
        rng=np.random.default_rng(options.seed),
    )
    return _Setup(robot, settings, sim, actors, stand, period_s, clock, backend)


def _preflight(options: RunOptions, setup: _Setup, info: DeviceInfo) -> None:
    """A simulated robot that is put at the clip's first frame is not at rest before."""
    checks = run_preflight(
        setup.backend,
        info,
        setup.clock,
        setup.robot,
        setup.runs,
        setup.settings.preflight,
        at_rest=options.start is Start.STAND,
    )
    print(f"preflight {info.name}\n{table(checks)}", flush=True)
    require(checks)


def _perform(
    options: RunOptions, setup: _Setup, performer: _Performer, film: "Film | None", signals: StopSignals
) -> tuple[str, str | None]:
    """Run the loop. Returns who ended it and why the plan gave up, if it did."""
    machine, recorder = performer.machine, performer.recorder
    release = BandRelease(setup.settings, setup.period_s)
    plan = _begin(options, setup, machine, release)
    observers: list[Observer] = [recorder, Console(refusals=options.interactive)]
    operators: list[RequestSource] = [signals]
    observers += [] if film is None else [film]
    with contextlib.ExitStack() as stack:
        if options.log is not None:
            about = {"backend": options.backend, "policy": options.policies[0], "robot": setup.robot.name}
            log = stack.enter_context(McapLog(options.log, setup.robot, about, may_wait=not options.on_wall_clock))
            print(f"log {log.path}", flush=True)
            observers.append(log)
        if options.viewer and isinstance(setup.backend, MujocoBackend):
            from deploy.viewing import ViewerObserver  # likewise

            window = stack.enter_context(ViewerObserver(setup.backend, recorder))
            observers.append(window)
            operators.append(window)
        if options.interactive:
            operators.append(stack.enter_context(Keyboard()))
        if options.on_wall_clock:
            stack.enter_context(realtime(lambda line: print(line, flush=True)))
        stack.enter_context(no_garbage_collection())
        loop = Loop(
            setup.backend,
            setup.clock,
            Tick(machine, performer.guard),
            operators=operators,
            plan=plan,
            release=release,
            observers=observers,
            duration_s=options.duration_s,
            timer=performer.timer,
        )
        loop.run()
    return loop.ended_by, None if plan is None else plan.failure


def _begin(options: RunOptions, setup: _Setup, machine: StateMachine, release: BandRelease) -> Plan | None:
    """Put a simulated robot where it starts, and decide who asks for the next step."""
    rng = np.random.default_rng(options.seed)
    backend = setup.backend
    if options.start is Start.REFERENCE and isinstance(backend, Placeable):
        place_at_reference(backend, setup.actors[0], options.start_noise_rad, rng)
        machine.start_tracking()
        return OnlyTheClip(machine)
    if options.start_noise_rad and isinstance(backend, MujocoBackend):
        noise = rng.normal(0.0, options.start_noise_rad, setup.robot.num_joints)
        backend.hang(setup.robot.default_pos_rad + noise, rng=rng)
    return None if options.interactive else Unattended(machine, release, setup.settings, setup.period_s)


def _report(options: RunOptions, setup: _Setup, performer: _Performer, ended_by: str, failure: str | None) -> RunReport:
    machine, performance = performer.machine, performer.recorder.performance
    actor = machine.tracked[machine.selected]
    metrics: dict[str, float | None] = dict.fromkeys(METRIC_KEYS)
    if performance is not None:
        metrics = performance.metrics(Kinematics(setup.robot))
    outcome, fault = "completed", None
    if machine.fault is not None:
        outcome, fault = "tripped", str(machine.fault)
    elif ended_by == "operator" or failure is not None:
        outcome, fault = "stopped", failure
    content = {
        "policy_sha256": actor.actor.sha256,
        "motion": actor.name,
        "backend": options.backend,
        "sim": options.sim if options.backend == "mujoco" else None,
        "outcome": outcome,
        "fault": fault,
        "fell": None if performance is None or not performance.known_root else performance.fallen_at is not None,
        "metrics": over_episodes([metrics]),
        "timing": performer.timer.report(),
        "limits": dict(performer.guard.counts),
    }
    return RunReport(outcome, fault, failure is not None, content)


def _new_film(path: Path, recorder: Recorder, setup: _Setup) -> "Film":
    """Drawing is an extra that a robot's computer need not have, hence the late import."""
    from deploy.film import Film

    reference = setup.actors[0].reference
    height_m = 0.0 if reference is None else float(reference.root_pos_w[0, 2])
    return Film(path, recorder, height_m, setup.period_s)


def summary(report: RunReport) -> Sequence[str]:
    """The result in lines for a person."""
    content = report.content
    lines = [f"outcome {report.outcome}" + (f" ({report.fault})" if report.fault else "")]
    known = {name: value["mean"] for name, value in content["metrics"].items() if value is not None}
    lines += [f"  {name:22} {value:.4g}" for name, value in known.items()]
    tick_ms, timing = content["timing"]["tick_ms"], content["timing"]
    if timing["ticks"]:
        text = f"p50 {tick_ms['p50']:.2f}, p99 {tick_ms['p99']:.2f}, max {tick_ms['max']:.2f}"
        lines.append(f"  {timing['ticks']} ticks, ms each: {text}; overruns {timing['overruns']}")
    acted = {rule: count for rule, count in content["limits"].items() if count}
    lines.append("  safety rules, ticks: " + (", ".join(f"{rule} {count}" for rule, count in acted.items()) or "none"))
    return lines
