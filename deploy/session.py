"""One run from options to result: load, preflight, loop, close, score."""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from core.clock import Clock, MonotonicClock, SimulatedClock
from deploy.actor_run import ActorRun
from deploy.actors import check_same_period, check_same_scene, load_run
from deploy.cell import Cell
from deploy.control.loop import Observer, Plan
from deploy.dry_run import RECORDS, DryRunRecord, dry_run, require_records
from deploy.episode import Start, place_at_reference
from deploy.operator.console import Console
from deploy.operator.keys import Keyboard, RequestSource, StopSignals
from deploy.operator.remote import Gamepad, RemoteButtons
from deploy.options import RunOptions
from deploy.preflight import require, run_preflight, table
from deploy.record.log import McapLog
from deploy.record.recorder import Recorder
from deploy.record.report import Ending, RunReport, make_report
from deploy.settings import DeploySettings, load_settings
from hal.contract.backend import Backend, Placeable
from hal.contract.types import DeviceInfo
from hal.emulator.launch import Emulator, launch_emulator
from hal.open import open_backend, wire_config, wire_config_sha256
from hal.realtime import no_garbage_collection, realtime
from hal.simulated.mujoco import MujocoBackend
from hal.wire.backend import WireBackend
from robot.robot import Robot, load_robot
from world.model import check_meshes, compile_model
from world.options import SimOptions, load_sim_options

if TYPE_CHECKING:
    from deploy.record.film import Film


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


def run_session(options: RunOptions, signals: StopSignals) -> RunReport:
    """Do what the options ask. Raises InputError before anything is opened, DeviceError where the device refuses."""
    options.check()
    with contextlib.ExitStack() as stack:
        setup = _prepare(options, stack)
        report_only = options.backend == "mujoco" and setup.sim.report_only
        modes = {"report_only": report_only, "fixed_stand": options.on_real_wire}
        cell = Cell(setup.robot, setup.settings, setup.actors, setup.stand, **modes)
        film = None if options.video is None else _new_film(options.video, cell.recorder, setup)
        stack.enter_context(contextlib.closing(setup.backend))
        _preflight(options, setup, setup.backend.open())
        if options.dry_run:
            ending = _rehearse(options, setup, cell, signals)
        else:
            ending = _perform(options, setup, cell, film, signals)
    report = make_report(options, setup.robot, cell, ending)
    if film is not None and not options.dry_run:
        scene = setup.actors[0].scene
        model = compile_model(setup.robot, timestep_s=setup.period_s, scene=scene, meshes=options.meshes)
        if not film.draw(model, lambda: signals.raised):
            print(f"stopped: {options.video} was not drawn", flush=True)
    return report


def _prepare(options: RunOptions, stack: contextlib.ExitStack) -> _Setup:
    """Load everything that a user may have got wrong, and start the emulator where one is asked for."""
    robot, settings, sim = load_robot(options.robot), load_settings(options.settings), load_sim_options(options.sim)
    if options.meshes is not None:
        check_meshes(robot, options.meshes)
    actors = tuple(load_run(policy, options.motion, robot, settings.entry) for policy in options.policies)
    stand = load_run(options.stand, None, robot, settings.entry) if options.start is Start.STAND else None
    period_s = check_same_period([*actors, *([] if stand is None else [stand])])
    if options.on_real_wire and not (options.dry_run or options.first_run_ok):
        require_records([(actor.name, _record(options, actor)) for actor in actors], RECORDS)
    clock: Clock = MonotonicClock() if options.on_wall_clock else SimulatedClock()
    backend = open_backend(
        options.backend,
        robot,
        clock,
        control_period_s=period_s,
        config=options.hal_config,
        sim=sim,
        scene=check_same_scene([*actors]),
        sim_model=options.sim_model,
        gantry=options.start is Start.STAND,
        meshes=options.meshes if options.viewer else None,
        rng=np.random.default_rng(options.seed),
        endpoints=options.endpoints,
        emulator=stack.enter_context(_emulator(options)) if options.emulate else None,
    )
    return _Setup(robot, settings, sim, actors, stand, period_s, clock, backend)


def _emulator(options: RunOptions) -> Emulator:
    """The robot at the other end of the wire."""
    return launch_emulator(
        options.backend,
        wire_config(options.backend, options.hal_config),
        robot=options.robot,
        faults=options.faults,
        start_noise_rad=options.start_noise_rad,
        seed=options.seed,
    )


def _record(options: RunOptions, actor: ActorRun) -> DryRunRecord:
    wire = wire_config_sha256(options.backend, options.hal_config, options.endpoints)
    return DryRunRecord(actor.actor.sha256, wire)


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


def _rehearse(options: RunOptions, setup: _Setup, cell: Cell, signals: StopSignals) -> Ending:
    """The dry run, and its record where it was the real wire."""
    with contextlib.ExitStack() as stack:
        if options.on_wall_clock:
            stack.enter_context(realtime(lambda line: print(line, flush=True)))
        stack.enter_context(no_garbage_collection())
        checks = dry_run(
            setup.backend,
            setup.clock,
            setup.runs,
            cell.guard,
            cell.timer,
            setup.settings.preflight,
            lambda: signals.raised,
        )
    print(f"dry run, nothing was written to the joints\n{table(checks)}", flush=True)
    if signals.raised:
        return Ending("operator", wire=_wire_report(setup.backend))
    require(checks, "dry run")
    if options.on_real_wire:
        for actor in setup.actors:
            content = {"backend": options.backend, "checks": {check.what: check.found for check in checks}}
            print(f"recorded {_record(options, actor).save(RECORDS, content)}", flush=True)
    return Ending("plan", wire=_wire_report(setup.backend))


def _wire_report(backend: Backend) -> dict[str, Any] | None:
    return backend.report() if isinstance(backend, WireBackend) else None


def _perform(options: RunOptions, setup: _Setup, cell: Cell, film: "Film | None", signals: StopSignals) -> Ending:
    """Run the loop."""
    plan = _begin(options, setup, cell)
    observers: list[Observer] = [Console(refusals=options.attended), *([] if film is None else [film])]
    with contextlib.ExitStack() as stack:
        if options.log is not None:
            about = {"backend": options.backend, "policy": options.policies[0], "robot": setup.robot.name}
            log = stack.enter_context(McapLog(options.log, setup.robot, about, may_wait=not options.on_wall_clock))
            print(f"log {log.path}", flush=True)
            observers.append(log)
        operators: list[RequestSource] = [signals]
        if options.viewer and isinstance(setup.backend, MujocoBackend):
            from deploy.operator.viewing import ViewerObserver  # likewise

            window = stack.enter_context(ViewerObserver(setup.backend, cell.recorder))
            observers.append(window)
            operators.append(window)
        operators += _operators(options, setup.backend, stack)
        if options.on_wall_clock:
            stack.enter_context(realtime(lambda line: print(line, flush=True)))
        stack.enter_context(no_garbage_collection())
        loop = cell.loop(
            setup.backend,
            setup.clock,
            plan=plan,
            operators=operators,
            observers=observers,
            duration_s=options.duration_s,
        )
        loop.run()
    return Ending(loop.ended_by, None if plan is None else plan.failure, _wire_report(setup.backend))


def _operators(options: RunOptions, backend: Backend, stack: contextlib.ExitStack) -> list[RequestSource]:
    """The people at keyboard, gamepad and remote."""
    operators: list[RequestSource] = []
    if options.attended:
        operators.append(stack.enter_context(Keyboard()))
    if options.gamepad is not None:
        operators.append(stack.enter_context(Gamepad(options.gamepad)))
    if isinstance(backend, WireBackend):
        operators.append(RemoteButtons(backend.remote))
    return operators


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

    reference = setup.actors[0].reference
    height_m = 0.0 if reference is None else float(reference.root_pos_w[0, 2])
    return Film(path, recorder, height_m, setup.period_s)
