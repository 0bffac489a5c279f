"""One run from options to result: load, preflight, loop, close, score."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from core.clock import Clock, MonotonicClock, SimulatedClock
from deploy.actor_run import ActorRun
from deploy.actors import check_bounds, check_same_period, check_same_scene, check_start, load_run
from deploy.cell import Cell
from deploy.clip_check import check_clip, rehearse
from deploy.control.loop import Observer, Plan
from deploy.dry_run import dry_run
from deploy.dry_run_record import RECORDS, DryRunRecord, record_of, require_records
from deploy.episode import Start, place_at_reference
from deploy.goals.open import Followed, GoalDesk
from deploy.operator.console import Console
from deploy.operator.estop import EStop
from deploy.operator.keys import RequestSource, StopSignals
from deploy.operator.people import people
from deploy.operator.voice import Voice
from deploy.options import RunOptions
from deploy.preflight import Check, require, run_preflight, table
from deploy.record.recorder import Recorder
from deploy.record.report import Ending, RunReport, make_report
from deploy.record.watching import watching
from deploy.settings import DeploySettings, load_settings
from hal.contract.backend import Backend, Placeable
from hal.contract.types import DeviceInfo
from hal.emulator.launch import Emulator, launch_emulator
from hal.open import open_backend, wire_config, wire_config_sha256
from hal.realtime import no_garbage_collection, realtime
from hal.simulated.mujoco import MujocoBackend
from hal.verification.record import RECORDS as VERIFIED
from hal.verification.record import VerifiedRecord
from hal.wire.backend import WireBackend
from robot.robot import Robot, load_robot
from world.model import check_meshes, compile_model
from world.options import SimOptions, load_sim_options
from world.scene import Scene

if TYPE_CHECKING:
    from deploy.record.film import Film


@dataclass(frozen=True)
class _Setup:
    robot: Robot
    settings: DeploySettings
    sim: SimOptions
    followed: Followed
    stand: ActorRun | None
    period_s: float
    clock: Clock
    backend: Backend
    voice: Voice

    @property
    def actors(self) -> tuple[ActorRun, ...]:
        return self.followed.runs

    @property
    def runs(self) -> list[ActorRun]:
        return [*self.actors, *([] if self.stand is None else [self.stand])]


def run_session(options: RunOptions, signals: StopSignals, voice: Voice) -> RunReport:
    """Do what the options ask. Raises InputError before anything is opened, DeviceError where the device refuses.

    A stop signal up to the end of the preflight, while nothing is energised, raises Stopped.
    """
    options.check()
    # What `kept` holds is left last: it is written when the wire is closed.
    with contextlib.ExitStack() as kept, contextlib.ExitStack() as stack:
        with signals.breaking_off():
            setup = _prepare(options, stack, voice)
            report_only = options.backend == "mujoco" and setup.sim.report_only
            modes = {"report_only": report_only, "fixed_stand": options.on_real_wire}
            cell = Cell(setup.robot, setup.settings, setup.actors, setup.stand, **modes)
            film = None if options.video is None else _new_film(options.video, cell.recorder, setup)
            stack.enter_context(contextlib.closing(setup.backend))
            _require_dry_runs(options, setup, None)
            wanted = setup.settings.estop
            estop = None if wanted is None else stack.enter_context(EStop(wanted, voice.complain))
            if options.dry_run and options.on_real_wire:
                _rehearse_clips(setup)
            info = setup.backend.open()
            _require_dry_runs(options, setup, info)
            _preflight(options, setup, info, [] if estop is None else [estop.check()])
        if options.dry_run:
            ending = _rehearse(options, setup, info, cell, signals)
        else:
            observers = watching(
                options, setup.robot, setup.backend, cell.guard.winding, setup.settings.record, voice, kept
            )
            ending = _perform(options, setup, cell, [*([] if film is None else [film]), *observers], signals, estop)
            if options.hand_back:
                _hand_back(setup, in_order=cell.machine.lowered and cell.machine.fault is None)
    report = make_report(options, setup.robot, cell, ending)
    if film is not None and not options.dry_run:
        scene = setup.actors[0].scene
        model = compile_model(setup.robot, timestep_s=setup.period_s, scene=scene, meshes=options.meshes)
        if not film.draw(model, lambda: signals.raised):
            voice.say(f"stopped: {options.video} was not drawn")
    return report


def _hand_back(setup: _Setup, *, in_order: bool) -> None:
    if in_order and isinstance(setup.backend, WireBackend):
        setup.backend.hand_back()
    else:
        setup.voice.say("not handed back: only a robot that was asked to end, was lowered and has no fault is")


def _prepare(options: RunOptions, stack: contextlib.ExitStack, voice: Voice) -> _Setup:
    """Load everything that a user may have got wrong, and start the emulator where one is asked for."""
    robot, settings, sim = load_robot(options.robot), load_settings(options.settings), load_sim_options(options.sim)
    if options.meshes is not None:
        check_meshes(robot, options.meshes)
    stand = load_run(options.stand, None, robot, settings.entry) if options.start is Start.STAND else None
    followed = GoalDesk(robot, settings, stand, voice.say, stack).open_all(options)
    runs = [*followed.runs, *([] if stand is None else [stand])]
    for run in runs:
        check_bounds(run, robot, settings.actor)
        if stand is not None:
            check_start(run, stand, robot, settings.entry)
    period_s = check_same_period(runs)
    scene = check_same_scene([*followed.runs])
    clock: Clock = MonotonicClock() if options.on_wall_clock else SimulatedClock()
    backend = open_backend(
        options.backend,
        robot,
        clock,
        control_period_s=period_s,
        config=options.hal_config,
        sim=sim,
        scene=scene,
        sim_model=options.sim_model,
        gantry=options.start is Start.STAND,
        meshes=options.meshes if options.viewer else None,
        rng=np.random.default_rng(options.seed),
        endpoints=options.endpoints,
        emulator=stack.enter_context(_emulator(options, scene)) if options.emulate else None,
    )
    return _Setup(robot, settings, sim, followed, stand, period_s, clock, backend, voice)


def _emulator(options: RunOptions, scene: Scene) -> Emulator:
    """The robot at the other end of the wire, in the scene of the motion."""
    return launch_emulator(
        options.backend,
        wire_config(options.backend, options.hal_config),
        robot=options.robot,
        scene=scene,
        faults=options.faults,
        start_noise_rad=options.start_noise_rad,
        seed=options.seed,
    )


def _dry_runs(options: RunOptions, setup: _Setup, info: DeviceInfo | None) -> list[tuple[str, DryRunRecord]]:
    """What must have been rehearsed, by the policy's name. info: None before the device was opened."""
    return [(actor.name, record_of(options, setup.robot, actor, setup.stand, info)) for actor in setup.actors]


def _require_dry_runs(options: RunOptions, setup: _Setup, info: DeviceInfo | None) -> None:
    if options.on_real_wire and not (options.dry_run or options.first_run_ok):
        require_records(_dry_runs(options, setup, info), RECORDS, setup.settings.preflight.dry_run_days)


def _rehearse_clips(setup: _Setup) -> None:
    """A clip that its actor was not trained for is played in simulation before anything is opened."""
    how = (setup.robot, setup.settings, setup.voice.say)
    checks = [check for actor in setup.followed.judged for check in rehearse(actor, *how)]
    if checks:
        setup.voice.say(table(checks))
        require(checks, "rehearsal")


def _preflight(options: RunOptions, setup: _Setup, info: DeviceInfo, besides: Sequence[Check]) -> None:
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
    checks += besides
    checks += _verified(options, setup, info)
    for actor in setup.followed.judged:
        checks += check_clip(actor, setup.robot, binding=options.on_real_wire)
    setup.voice.say(f"preflight {info.name}\n{table(checks)}")
    require(checks)


def _verified(options: RunOptions, setup: _Setup, info: DeviceInfo) -> list[Check]:
    """Whether a person has seen that this real robot is the one of its files."""
    if not options.on_real_wire:
        return []
    wire = wire_config_sha256(options.backend, options.hal_config, options.endpoints)
    problem = VerifiedRecord(wire, setup.robot.name, info.identities).problem(VERIFIED)
    waived = options.dry_run or options.first_run_ok
    return [Check("verified", problem is None or waived, problem or "joints and IMU are as the files say")]


def _rehearse(options: RunOptions, setup: _Setup, info: DeviceInfo, cell: Cell, signals: StopSignals) -> Ending:
    """The dry run, and its record where it was the real wire."""
    with contextlib.ExitStack() as stack:
        stack.enter_context(no_garbage_collection())
        if options.on_wall_clock:
            stack.enter_context(realtime(setup.voice.say))
        checks = dry_run(
            setup.backend,
            setup.clock,
            setup.runs,
            cell.guard,
            cell.timer,
            setup.settings.preflight,
            lambda: signals.raised,
        )
    setup.voice.say(f"dry run, nothing was written to the joints\n{table(checks)}")
    if signals.raised:
        return Ending("operator", wire=_wire_report(setup.backend))
    require(checks, "dry run")
    if options.on_real_wire:
        content = {"backend": options.backend, "checks": {check.what: check.found for check in checks}}
        for _, record in _dry_runs(options, setup, info):
            setup.voice.say(f"recorded {record.save(RECORDS, content)}")
    return Ending("plan", wire=_wire_report(setup.backend))


def _wire_report(backend: Backend) -> dict[str, Any] | None:
    return backend.report() if isinstance(backend, WireBackend) else None


def _perform(
    options: RunOptions, setup: _Setup, cell: Cell, seeing: list[Observer], signals: StopSignals, estop: EStop | None
) -> Ending:
    """Run the loop. seeing: who looks on besides the console."""
    console = Console(setup.voice, setup.backend, setup.clock, refusals=options.attended)
    observers = [console, *seeing]
    with contextlib.ExitStack() as stack:
        operators: list[RequestSource] = [signals]
        if options.viewer and isinstance(setup.backend, MujocoBackend):
            from deploy.operator.viewing import ViewerObserver  # likewise

            window = stack.enter_context(ViewerObserver(setup.backend, cell.recorder))
            observers.append(window)
            operators.append(window)
        shared = (setup.settings.operator, setup.clock, setup.voice)
        buttons = [] if estop is None else [estop]
        steered = (buttons, setup.followed.sticks)
        operators += people(options, setup.backend, lambda: cell.machine.mode, *shared, stack, *steered)
        stack.enter_context(no_garbage_collection())
        if options.on_wall_clock:
            stack.enter_context(realtime(setup.voice.say))
        plan = _begin(options, setup, cell)  # last: a simulated robot that waits for its first tick falls meanwhile
        loop = cell.loop(
            setup.backend,
            setup.clock,
            plan=plan,
            operators=operators,
            observers=observers,
            duration_s=options.duration_s,
            complain=setup.voice.complain,
        )
        try:
            loop.run()
        finally:
            console.finish()
    return Ending(loop.ended_by, None if plan is None else plan.failure, _wire_report(setup.backend))


def _begin(options: RunOptions, setup: _Setup, cell: Cell) -> Plan | None:
    """Put a simulated robot where it starts, and decide who asks for the next step."""
    rng = np.random.default_rng(options.seed)
    backend = setup.backend
    if options.start is Start.REFERENCE and isinstance(backend, Placeable):
        place_at_reference(backend, setup.actors[0], options.start_noise_rad, rng)
        return cell.start_tracking()
    if options.start_noise_rad and isinstance(backend, MujocoBackend):
        noise = rng.normal(0.0, options.start_noise_rad, setup.robot.num_joints)
        backend.hang(setup.robot.default_pos_rad + noise, rng=rng)
    return None if options.attended else cell.unattended()


def _new_film(path: Path, recorder: Recorder, setup: _Setup) -> "Film":
    """Drawing is an extra that a robot's computer need not have, hence the late import."""
    from deploy.record.film import Film

    height_m = float(setup.actors[0].goals.setting.root_pos_w[0, 2])
    return Film(path, recorder, height_m, setup.period_s)
