#!/usr/bin/env -S python3 -P
"""What standing up meets: from many poses on the gantry, how far joints lag, how long it waits, and how it ends."""

import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from core.arguments import ArgumentParser
from core.clock import SimulatedClock
from core.command import guarded
from core.files import check_output_file, write_json
from core.rotations import quat_from_axis_angle
from deploy.actors import load_run
from deploy.cell import Cell
from deploy.control.modes import Mode, Request
from deploy.control.states import StateMachine
from deploy.control.tick import TickResult
from deploy.control.timing import PhaseTimer
from deploy.settings import load_settings
from hal.contract.types import RobotState
from hal.simulated.mujoco import MujocoBackend
from robot.robot import Robot, load_robot
from world.actuation import JointCommand
from world.options import load_sim_options

LIMIT_S, PERIOD_S = 40.0, 0.02
LIMP_S, CLEARANCE_M = 3.0, 0.05
FORWARD, LEFT = np.array([0.0, 1.0, 0.0]), np.array([-1.0, 0.0, 0.0])
COLUMNS = [
    {"head": "pose", "path": "pose"},
    {"head": "model, simulation", "path": "model"},
    {"head": "largest lag, rad", "path": "lag_rad", "digits": 2},
    {"head": "of", "path": "joint"},
    {"head": "s before STAND_UP", "path": "before_s", "digits": 1},
    {"head": "s in STAND_UP", "path": "standing_s", "digits": 1},
    {"head": "ends in", "path": "ends"},
]


@dataclass(frozen=True)
class Pose:
    """Joints by the ends of their names, lean of the base, and how long it hangs slack before it is commanded."""

    joints: dict[str, float] = field(default_factory=dict)
    lean_rad: float = 0.0
    lean_axis: np.ndarray = field(default_factory=lambda: FORWARD)
    slack_s: float = 0.0


RAISED = {"shoulder_pitch": -2.8}
CROUCHED = {"hip_pitch": -0.9, "knee": 1.7, "ankle_pitch": -0.8}
POSES = {
    "default pose": Pose(),
    "arms limp": Pose(slack_s=LIMP_S),
    "arms raised": Pose(RAISED),
    "arms raised, let fall": Pose(RAISED, slack_s=LIMP_S),
    "arms forward": Pose({"shoulder_pitch": -1.5, "elbow": 0.0}),
    "arms back": Pose({"shoulder_pitch": 1.2, "elbow": 1.5}),
    "arms aside": Pose({"left_shoulder_roll": 1.5, "right_shoulder_roll": -1.5}),
    "arms crossed": Pose({"left_shoulder_yaw": -1.2, "right_shoulder_yaw": 1.2, "elbow": 1.6}),
    "crouched": Pose(CROUCHED),
    "crouched, let sink": Pose(CROUCHED, slack_s=LIMP_S),
    "legs straight": Pose({"hip_pitch": 0.0, "knee": 0.0, "ankle_pitch": 0.0}),
    "leaning forward by 0.3": Pose(lean_rad=0.3),
    "leaning back by 0.3": Pose(lean_rad=-0.3),
    "leaning left by 0.3": Pose(lean_rad=0.3, lean_axis=LEFT),
    "leaning forward, let hang": Pose(lean_rad=0.3, slack_s=LIMP_S),
}


class Watch:
    """A plan and an observer: stands up, and quits in READY, at a fault, or when its patience ends."""

    failure: str | None = None

    def __init__(self, machine: StateMachine) -> None:
        self._machine = machine
        self.ready, self.ticks, self.standing = False, 0, 0
        self.worst_rad, self.joint, self.obstacle = 0.0, "", ""

    def requests(self, state: RobotState | None) -> Sequence[Request]:
        """See Plan."""
        self.ticks += 1
        if self.ready or self.ticks * PERIOD_S > LIMIT_S or self._machine.fault is not None:
            return (Request.QUIT,)
        return (Request.STAND,) if self.ticks == 1 else ()

    def __call__(self, state: RobotState | None, result: TickResult, timer: PhaseTimer) -> None:
        """See Observer."""
        self.ready = self.ready or result.mode is Mode.READY
        if result.mode is not Mode.STAND_UP or result.command is None or state is None:
            return
        self.standing += 1
        stand = self._machine.tracked[0]
        self.obstacle = stand.obstacle(state) or ""
        error = np.abs(state.joint_pos_rad - result.command.q_rad)
        if error.max() > self.worst_rad:
            self.worst_rad, self.joint = float(error.max()), stand.actor.spec.joint_names[int(error.argmax())]


def pose_of(robot: Robot, changes: dict[str, float]) -> np.ndarray:
    """The default pose but for the joints whose names end so, within their ranges."""
    pose = robot.default_pos_rad.copy()
    for index, name in enumerate(robot.joint_names):
        for part, value in changes.items():
            if name.removesuffix("_joint").endswith(part):
                pose[index] = value
    return np.clip(pose, robot.pos_lower_rad, robot.pos_upper_rad)


def stand_up(robot: Robot, name: str, sim: str, sim_model: Path | None) -> dict[str, Any]:
    """One row of the table."""
    pose = POSES[name]
    settings, clock = load_settings(), SimulatedClock()
    backend = MujocoBackend(robot, clock, load_sim_options(sim), sim_model=sim_model, gantry=True)
    stand = load_run("stand", None, robot, settings.entry)
    cell = Cell(robot, settings, [stand], stand)
    with backend:
        backend.hang(pose_of(robot, pose.joints))
        if pose.lean_rad:
            backend.data.qpos[2] += CLEARANCE_M
            backend.data.qpos[3:7] = quat_from_axis_angle(pose.lean_axis, np.array(pose.lean_rad))
        if pose.slack_s:
            backend.write(slack := JointCommand(*np.zeros((5, robot.num_joints))))
            for _ in range(round(pose.slack_s / backend.control_period_s)):
                clock.sleep_until(clock.now_s() + backend.control_period_s)
                backend.write(slack)
        watch = Watch(cell.machine)
        cell.loop(backend, clock, plan=watch, observers=[watch]).run()
    return {
        "pose": name,
        "model": "own, default" if sim_model is None else f"{sim_model.stem}, {sim}",
        "lag_rad": watch.worst_rad,
        "joint": watch.joint.removesuffix("_joint"),
        "before_s": PERIOD_S * (watch.ticks - watch.standing),
        "standing_s": PERIOD_S * watch.standing,
        "ends": "READY" if watch.ready else str(cell.machine.fault or f"STAND_UP: {watch.obstacle}"),
    }


@guarded
def main() -> int:
    """Print the table, and write it as a file of benchmarks/results."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--sim-model", type=Path, metavar="FILE", help="another MJCF besides, as in --sim reference")
    parser.add_argument("--json", type=Path, metavar="F")
    given = parser.parse_args()
    check_output_file("--json", given.json)
    robot = load_robot()
    models: list[tuple[str, Path | None]] = [("default", None)]
    models += [] if given.sim_model is None else [("reference", given.sim_model)]
    rows = []
    for name, model in itertools.product(POSES, models):
        rows.append(stand_up(robot, name, *model))
        print(" | ".join(map(str, rows[-1].values())), flush=True)
    command = "benchmarks/stand_up.py" + ("" if given.sim_model is None else f" --sim-model {given.sim_model}")
    document = {"commands": [command], "columns": COLUMNS, "rows": rows}
    if given.json is not None:
        write_json(given.json, document)
    return 0


if __name__ == "__main__":
    sys.exit(main())
