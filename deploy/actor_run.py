"""One actor as the state machine sees it: what it follows, its gains, and when it may take over."""

import math
from collections.abc import Callable

import numpy as np

from core.rotations import yaw_of
from deploy.goals.source import Goal, GoalSource
from deploy.safety.rules import Asked, tilt_rad
from deploy.settings import EntrySettings
from hal.contract.types import RobotState
from policy.actor import Actor
from policy.controller import PolicyController, PolicyOutput
from robot.robot import Robot


class ActorRun:
    """An actor with its own history, raw last action and tick count, all forgotten when it starts.

    goals: what it follows. tick: control ticks since it started. goal: what it was shown in the latest of them.
    scene: what it stands in.
    """

    def __init__(self, actor: Actor, robot: Robot, entry: EntrySettings, goals: GoalSource) -> None:
        self.actor, self.goals = actor, goals
        self.name, self.clip, self.reference = goals.name, goals.clip, goals.reference
        self.scene = goals.setting.scene
        self.start_pose_rad = goals.start_pose_rad
        self.period_s = actor.spec.control_period_s
        self.tick = 0
        self.goal: Goal | None = None
        self._controller = PolicyController(actor, robot)
        self._entry = entry
        self._joint_names = robot.joint_names

    @property
    def num_ticks(self) -> int:
        """Control ticks of its clip; 0 where it does not follow one."""
        return 0 if self.reference is None else self.reference.num_ticks

    @property
    def finished(self) -> bool:
        """Whether what it follows is over."""
        return self.goals.finished

    @property
    def resting(self) -> bool:
        """Whether what it follows leaves the robot to the stand actor, as soon as that can take over."""
        return self.goals.resting

    @property
    def asked(self) -> Asked | None:
        """What is asked of the body now; None: to stand upright at rest."""
        return self.goals.asked

    def start(self) -> None:
        """The first tick of what it follows, with an empty memory."""
        self._controller.reset()
        self.goals.start()
        self.tick = 0

    def give_way(self) -> None:
        """The stand actor is wanted: see GoalSource."""
        self.goals.give_way()

    def act(self, state: RobotState, lap: Callable[[str], None] | None = None) -> PolicyOutput:
        """One control tick."""
        self.goal = goal = self.goals.next(float(yaw_of(state.imu_quat_wxyz)))
        self.tick += 1
        return self._controller.act(
            state.imu_quat_wxyz, state.imu_ang_vel_b, state.joint_pos_rad, state.joint_vel_rad_s, goal.phase, lap,
            reference=goal.reference, tick=goal.tick, visible=goal.visible, turn_rad=goal.turn_rad,
        )  # fmt: skip

    def obstacle(self, state: RobotState) -> str | None:
        """Why this actor may not take over from this state, or None where it may."""
        entry = self._entry
        distance, speed = np.abs(state.joint_pos_rad - self.start_pose_rad), np.abs(state.joint_vel_rad_s)
        far, fast = int(np.argmax(distance)), int(np.argmax(speed))
        if not distance[far] <= entry.joint_rad:
            name = self._joint_names[far]
            return f"{name} is {distance[far]:.2f} rad from the start pose of {self.name}, limit {entry.joint_rad}"
        if not speed[fast] < entry.joint_vel_rad_s:
            return f"{self._joint_names[fast]} moves at {speed[fast]:.2f} rad/s, limit {entry.joint_vel_rad_s}"
        return unsteady(state, entry)


def unsteady(state: RobotState, entry: EntrySettings) -> str | None:
    """Why the base does not rest upright enough to hand over, or None."""
    tilt, spin = tilt_rad(state.imu_quat_wxyz), math.dist(state.imu_ang_vel_b.tolist(), (0.0, 0.0, 0.0))
    if not tilt < entry.tilt_rad:
        return f"tilt {tilt:.2f} rad, limit {entry.tilt_rad}"
    if not spin < entry.ang_vel_rad_s:
        return f"the base turns at {spin:.2f} rad/s, limit {entry.ang_vel_rad_s}"
    return None
