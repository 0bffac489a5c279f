#!/usr/bin/env -S python3 -P
"""How fast the pelvis comes down when a standing robot is put down at the end, and when it is damped where it stands.

benchmarks/lowering.py --starts 10 --json F
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from core.arguments import ArgumentParser, path_argument, positive_count_argument
from core.clock import SimulatedClock
from core.command import guarded
from core.files import check_output_file, write_json
from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.cell import Cell
from deploy.control.modes import Mode, Request
from deploy.episode import place_at_reference
from deploy.settings import DeploySettings, load_settings
from hal.contract.types import RobotState
from hal.simulated.mujoco import MujocoBackend
from robot.robot import Robot, load_robot
from world.options import load_sim_options

PERIOD_S = 0.02
START_NOISE_RAD = 0.02


@dataclass
class Fall:
    """What the pelvis did from the request until the joints rested."""

    fastest_m_s: float = 0.0
    lowest_m: float = np.inf
    largest_tilt_rad: float = 0.0
    watching: bool = False

    def see(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """One moment."""
        if self.watching:
            self.fastest_m_s = max(self.fastest_m_s, float(np.linalg.norm(data.qvel[:3])))
            self.lowest_m = min(self.lowest_m, float(data.qpos[2]))
            up_z = 1.0 - 2.0 * float(data.qpos[4] ** 2 + data.qpos[5] ** 2)
            self.largest_tilt_rad = max(self.largest_tilt_rad, float(np.arccos(np.clip(up_z, -1.0, 1.0))))


class _HoldThen:
    """The plan: the stand actor, held for a while, then the request under test."""

    failure: str | None = None

    def __init__(self, cell: Cell, fall: Fall, ending: Request, ticks: int) -> None:
        self._cell, self._fall, self._ending, self._ticks = cell, fall, ending, ticks

    def requests(self, state: RobotState | None) -> Sequence[Request]:
        """See Plan."""
        self._ticks -= 1
        if self._cell.machine.mode is Mode.TRACKING:
            return (Request.HOLD,)
        self._fall.watching = self._ticks <= 0
        return (self._ending,) if self._fall.watching else ()


@cache
def _rig() -> tuple[Robot, DeploySettings, ActorRun, ActorRun]:
    """Robot, settings, and the stand actor twice, as who holds and who is tracked; each start uses them anew."""
    robot, settings = load_robot(), load_settings()
    stand, tracked = (load_run("stand", None, robot, settings.entry) for _ in range(2))
    return robot, settings, stand, tracked


def put_down(seed: int, ending: Request) -> Fall:
    """Stand for 1 to 3 s from a start that the seed draws, then end as asked, in the default simulation."""
    rng, fall = np.random.default_rng(seed), Fall()
    robot, settings, stand, tracked = _rig()
    clock, options = SimulatedClock(), load_sim_options("default")
    backend = MujocoBackend(robot, clock, options, control_period_s=PERIOD_S, gantry=False, rng=rng)
    cell = Cell(robot, settings, [tracked], stand)
    with backend:
        place_at_reference(backend, tracked, START_NOISE_RAD, rng)
        cell.machine.start_tracking()
        backend.on_advance = fall.see
        plan = _HoldThen(cell, fall, ending, int(rng.integers(50, 150)))
        cell.loop(backend, clock, plan=plan).run()
    if cell.machine.fault is not None:
        raise RuntimeError(f"seed {seed}: {cell.machine.fault}")
    return fall


@guarded
def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row per start. Exit code 0, or 2 on bad input."""
    parser = ArgumentParser(prog="benchmarks/lowering.py", description=__doc__, allow_abbrev=False)
    parser.add_argument("--starts", type=positive_count_argument, default=10, metavar="N")
    parser.add_argument("--json", type=path_argument, metavar="F")
    given = parser.parse_args(arguments)
    check_output_file("--json", given.json)
    rows = []
    for name, ending in (("lowered", Request.FINISH), ("damped", Request.QUIT)):
        falls = [put_down(seed, ending) for seed in range(given.starts)]
        speeds = [fall.fastest_m_s for fall in falls]
        tilt_rad = max(fall.largest_tilt_rad for fall in falls)
        row = {"ending": name, "starts": given.starts, "median_m_s": float(np.median(speeds)), "max_m_s": max(speeds)}
        rows.append({**row, "max_tilt_rad": tilt_rad})
        print(
            f"{name:8} pelvis m/s: median {np.median(speeds):.2f}, max {max(speeds):.2f}; tilt max {tilt_rad:.2f} rad"
        )
    if given.json is not None:
        write_json(given.json, {"rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
