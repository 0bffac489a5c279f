"""An actor that follows goals and is one matrix: it balances by its ankles, and shows what it sees in its joints."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from core.clock import SimulatedClock
from deploy.actor_run import ActorRun
from deploy.actors import load_run
from deploy.cell import Cell
from deploy.control.modes import Mode, Request
from deploy.goals.guard import GoalGuard, Steer
from deploy.goals.steering import SteerGoal
from hal.simulated.mujoco import MujocoBackend
from policy.actor import load_actor
from policy.layouts import goals_actor_group
from policy.metadata import write_metadata
from policy.observation import entry_size, term_dims
from policy.spec import motion_info
from tests.deploy.toys import BALANCE, JOINTS, PERIOD_S, ROBOT, SETTINGS, write_matrix_actor, write_standing_actor
from world.options import load_sim_options

GROUP = goals_actor_group("obs")
DIMS = term_dims(JOINTS)
SIZE = sum(len(entry.moments) * entry_size(entry, DIMS) for entry in GROUP.terms)
# Speed forward, to the left, turn, and sine of the heading away, one joint each.
SHOWN = ("left_shoulder_pitch_joint", "left_shoulder_roll_joint", "left_shoulder_yaw_joint", "left_elbow_joint")
SHOWS = {("goal_steer", number, joint): 0.1 for number, joint in enumerate(SHOWN)}


def column(term: str, of: str = "") -> slice:
    """Where the first use of a term, which is that of now, lies in the observation."""
    first = 0
    for entry in GROUP.terms:
        size = len(entry.moments) * entry_size(entry, DIMS)
        if (entry.term, entry.of) == (term, of):
            return slice(first, first + size)
        first += size
    raise KeyError(term)


def write_goal_actor(path: Path, everything: float = 0.0, provenance: dict | None = None) -> Path:
    """target = default + what BALANCE and SHOWS say + everything times a fixed random matrix times the observation."""
    matrix = everything * np.random.default_rng(0).normal(size=(SIZE, JOINTS)).astype(np.float32)
    for (term, index, joint), weight in (BALANCE | SHOWS).items():
        scale = next(entry.scale for entry in GROUP.terms if entry.term == term)
        matrix[column(term).start + index, ROBOT.joint_names.index(joint)] += weight / 0.25 / scale
    spec = write_matrix_actor(path, matrix, GROUP, follows="any_clip", provenance=provenance or {})
    write_metadata(path, spec)
    return path


def standing_run(folder: Path):
    """The stand actor of these tests."""
    return load_run(write_standing_actor(folder / "stand.onnx"), None, ROBOT, SETTINGS.entry)


class Hand:
    """A pilot in the test's hands."""

    def __init__(self):
        self.steer, self.starts = Steer(0.0, 0.0, 0.0), 0

    def start(self):
        self.starts += 1

    def next(self):
        return self.steer


class Stage:
    """A steered robot in MuJoCo, a pilot in the test's hands, and all that was commanded."""

    def __init__(self, folder):
        self.stand, self.hand, self.commands, self.modes = standing_run(folder), Hand(), [], []
        self.states = []
        standing = motion_info(self.stand.clip, "stick", self.stand.start_pose_rad)
        goal = SteerGoal("stick", self.hand, self.stand.goals.setting, GoalGuard(SETTINGS.goals, PERIOD_S))
        actor = load_actor(folder / "goals.onnx", ROBOT, standing)
        self.cell = Cell(ROBOT, SETTINGS, [ActorRun(actor, ROBOT, SETTINGS.entry, goal)], self.stand)
        self.tracked = 0

    def steer(self, tick):
        """What the pilot wants at a tick of TRACKING."""
        return Steer(0.0, 0.0, 0.0)

    def __call__(self, state, result, timer):
        self.modes += result.modes
        self.tracked += result.mode is Mode.TRACKING
        self.hand.steer = self.steer(self.tracked)
        if result.command is not None and result.mode is Mode.TRACKING:
            self.commands.append(result.command)
            self.states.append(state)

    def run(self, plan=None, seen_enough=lambda: False):
        """From standing in the gantry, which is then released, until the plan ends or enough was seen."""
        clock = SimulatedClock()
        plan, options = plan or self.cell.unattended(), load_sim_options("default")
        watcher = SimpleNamespace(poll=lambda: (Request.QUIT,) if seen_enough() else ())
        with MujocoBackend(ROBOT, clock, options, control_period_s=PERIOD_S, gantry=True) as backend:
            self.cell.machine._activate(self.stand, Mode.READY)
            how = {"plan": plan, "operators": [watcher], "observers": [self], "duration_s": 60.0}
            self.cell.loop(backend, clock, **how).run()
