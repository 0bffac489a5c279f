#!/usr/bin/env -S python3 -P
"""What a robot that falls meets on the ground: as it is deployed, against damped at once, stiff and slack.

benchmarks/falls.py --seeds 4 --json F
The bundled actors are kicked in MuJoCo until a rule trips. From there each way down begins at the same state.
Deployed: braced, but for a fall that trips another rule first. Stiff: the actor's last targets and gains.
Kicks that are balanced are left out.
"""

import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import mujoco
import numpy as np

from core.arguments import ArgumentParser, path_argument, positive_count_argument
from core.clock import SimulatedClock
from core.command import guarded
from core.files import check_output_file, write_json
from deploy.actors import load_run
from deploy.cell import Cell
from deploy.episode import place_at_reference
from deploy.settings import DeploySettings, load_settings
from hal.simulated.mujoco import MujocoBackend
from robot.robot import Robot, load_robot
from world.actuation import JointCommand, damping_command
from world.options import load_sim_options

PERIOD_S, STEP_S, PLAYS_S, LANDS_S = 0.02, 0.001, 3.0, 2.0
START_NOISE_RAD = 0.02
# actor, tick of the kick, its velocity in the world in m/s
FALLS: tuple[tuple[str, int, tuple[float, float]], ...] = (
    ("stand", 40, (2.5, 0.0)),
    ("stand", 40, (-2.5, 0.0)),
    ("stand", 40, (0.0, 2.4)),
    ("stand", 40, (0.0, -2.4)),
    ("side_kick", 180, (2.0, 0.0)),
    ("charleston", 250, (-2.0, 0.0)),
    ("taichi", 250, (0.0, 3.5)),
    ("horse_stance_punch", 200, (0.0, -4.0)),
    ("horse_stance_punch", 200, (-2.5, 0.0)),
    ("taichi", 250, (2.5, 0.0)),
)
PARTS = {"trunk": ("pelvis", "waist", "torso", "head"), "arms": ("shoulder", "elbow", "wrist", "hand")}


@dataclass
class Landing:
    """The worst that one way down met, but for the feet.

    force_n: of the ground on each part, together. load_nm: on one joint, by the ground and by the joint's stops.
    """

    force_n: dict[str, float] = field(default_factory=lambda: dict.fromkeys((*PARTS, "legs"), 0.0))
    joint_rad_s: float = 0.0
    load_nm: float = 0.0

    def see(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """One moment."""
        found, force = dict.fromkeys(self.force_n, 0.0), np.zeros(6)
        for number in range(data.ncon):
            bodies = [model.body(model.geom_bodyid[geom]).name for geom in data.contact[number].geom]
            part = next((part for body in bodies if (part := _part(body))), None)
            if part is not None and "world" in bodies:
                mujoco.mj_contactForce(model, data, number, force)
                found[part] += float(force[0])
        self.force_n = {part: max(self.force_n[part], found[part]) for part in found}
        self.joint_rad_s = max(self.joint_rad_s, float(np.abs(data.qvel[6:]).max()))
        self.load_nm = max(self.load_nm, float(np.abs(data.qfrc_constraint[6:]).max()))

    def figures(self) -> dict[str, float]:
        """By name and unit."""
        forces = {f"{part}_n": force for part, force in self.force_n.items()}
        return {**forces, "load_nm": self.load_nm, "joint_rad_s": self.joint_rad_s}


@cache
def _part(body: str) -> str | None:
    """Which part a body belongs to; None for the feet and the world."""
    if body == "world" or "ankle" in body:
        return None
    return next((part for part, names in PARTS.items() if any(name in body for name in names)), "legs")


def landings(
    name: str, kick_tick: int, velocity_xy: tuple[float, float], seed: int, *, randomize: bool
) -> tuple[str, dict[str, Landing]]:
    """Kick, wait for a rule to trip, then go down each way from there. The rule; empty where nothing trips."""
    robot, settings = _rig()
    actor, clock = load_run(name, None, robot, settings.entry), SimulatedClock()
    options = replace(load_sim_options("default"), randomize=randomize)
    found: dict[str, Landing] = {}
    with MujocoBackend(robot, clock, options, control_period_s=PERIOD_S, gantry=False, scene=actor.scene) as backend:
        place_at_reference(backend, actor, START_NOISE_RAD, np.random.default_rng(seed))
        cell = Cell(robot, settings, [actor])
        last, first = _until_trip(backend, cell, kick_tick, velocity_xy)
        if last is None or cell.machine.fault is None:
            return "", found
        rule, zero, damping = cell.machine.fault.rule, np.zeros(robot.num_joints), damping_command(robot.damping_kd)
        slack = JointCommand(zero, zero, zero, zero, zero)
        ways: Mapping[str, Callable[[], JointCommand]] = {
            "deployed": lambda: (first.pop() if first else cell.tick(backend.read()).command) or damping,
            "damped": lambda: damping,
            "stiff": lambda: last,
            "slack": lambda: slack,
        }
        model, data, physics = backend.model, backend.data, mujoco.mjtState.mjSTATE_FULLPHYSICS
        there = np.empty(mujoco.mj_stateSize(model, physics))
        mujoco.mj_getState(model, data, there, physics)
        for way, told in ways.items():
            mujoco.mj_setState(model, data, there, physics)
            found[way] = _land(backend, told)
    return rule, found


def _land(backend: MujocoBackend, told: Callable[[], JointCommand]) -> Landing:
    """Two seconds of what the joints are told in each control period, seen at every millisecond."""
    landing = Landing()
    backend.on_advance = landing.see
    for _ in range(round(LANDS_S / PERIOD_S)):
        backend.write(told())
        for _ in range(round(PERIOD_S / STEP_S)):
            backend.clock.sleep_until(backend.clock.now_s() + STEP_S)
            backend.read()
    backend.on_advance = None
    return landing


def _until_trip(
    backend: MujocoBackend, cell: Cell, kick_tick: int, velocity_xy: tuple[float, float]
) -> tuple[JointCommand | None, list[JointCommand | None]]:
    """The last command before a rule tripped, None where none did; and that of the tick in which it did."""
    cell.start_tracking()
    last = None
    for tick in range(kick_tick + round(PLAYS_S / PERIOD_S)):
        if tick == kick_tick:
            backend.data.qvel[:2] += velocity_xy
        result = cell.tick(backend.read())
        if result.fault is not None or result.command is None:
            return last, [result.command]
        last = result.command
        backend.write(last)
        backend.clock.sleep_until(backend.clock.now_s() + PERIOD_S)
    return None, []


@cache
def _rig() -> tuple[Robot, DeploySettings]:
    return load_robot(), load_settings()


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row per way down, means and largest values over all falls. Exit code 0, or 2 on bad input."""
    parser = ArgumentParser(prog="benchmarks/falls.py", description=__doc__, allow_abbrev=False)
    parser.add_argument("--seeds", type=positive_count_argument, default=2, metavar="N", help="of each fall; default 2")
    parser.add_argument("--randomize", action="store_true", help="robot and ground differ by seed")
    parser.add_argument("--json", type=path_argument, metavar="F")
    given = parser.parse_args(arguments)
    check_output_file("--json", given.json)
    tried = [landings(*fall, seed, randomize=given.randomize) for fall in FALLS for seed in range(given.seeds)]
    falls = [fall for _, fall in tried if fall]
    print(f"tripped by {dict(Counter(rule for rule, _ in tried if rule))}, {len(tried) - len(falls)} balanced")
    rows = []
    for way in falls[0] if falls else ():
        figures = [fall[way].figures() for fall in falls]
        row: dict[str, float | str] = {"way": way, "falls": len(falls)}
        for name in figures[0]:
            row[name] = float(np.mean([one[name] for one in figures]))
            row[f"{name}_max"] = float(np.max([one[name] for one in figures]))
        rows.append(row)
        print(", ".join(f"{key} {value:.4g}" if isinstance(value, float) else str(value) for key, value in row.items()))
    if given.json is not None:
        write_json(given.json, {"rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
