"""One actor as the state machine sees it: its clock, its gains, and when it may take over."""

import math
from collections.abc import Callable

import numpy as np

from core.errors import InputError
from core.rotations import quat_rotate_inverse
from deploy.safety.rules import Asked, tilt_rad, up_in_base
from deploy.settings import EntrySettings
from hal.contract.types import RobotState
from motion.clip import Clip
from motion.reference import Reference
from policy.actor import Actor
from policy.controller import PolicyController, PolicyOutput
from robot.robot import Robot
from world.scene import FLAT


class ActorRun:
    """An actor with its own history, raw last action and tick count, all forgotten when it starts.

    num_ticks: control ticks of its clip, floor(duration/dt). start_pose_rad: (J,) in the robot's joint order.
    clip, reference: what it tracks, and what that asks for at every tick.
    scene: what that stands in.
    Raises InputError when the actor carries no motion.
    """

    def __init__(
        self,
        actor: Actor,
        robot: Robot,
        entry: EntrySettings,
        reference: Reference | None = None,
        clip: Clip | None = None,
    ) -> None:
        spec = actor.spec
        if spec.motion is None:
            raise InputError("the actor has no reference motion", where=actor.path, hint="give --motion")
        self.actor = actor
        self.clip, self.reference = clip, reference
        self.scene = FLAT if reference is None else reference.scene
        self.name = spec.motion.name
        self.period_s = spec.control_period_s
        self.duration_s = spec.motion.duration_s
        self.num_ticks = math.floor(self.duration_s / self.period_s + 1e-9)
        pose = dict(zip(spec.joint_names, spec.motion.start_joint_pos_rad))
        pose |= {joint.name: joint.pos_rad for joint in spec.held_joints}
        self.start_pose_rad = np.array([pose[name] for name in robot.joint_names], dtype=np.float64)
        self.tick = 0
        self._controller = PolicyController(actor, robot)
        self._entry = entry
        self._joint_names = robot.joint_names
        self._asked = () if reference is None else asked_by(reference)

    @property
    def finished(self) -> bool:
        """Whether the clip has been played to its end."""
        return self.tick >= self.num_ticks

    @property
    def asked(self) -> Asked | None:
        """What the clip asks of the body now; None where the actor's file carries no table of it."""
        return self._asked[min(self.tick, self.num_ticks)] if self._asked else None

    def start(self) -> None:
        """Tick 0 of the clip, with an empty memory."""
        self._controller.reset()
        self.tick = 0

    def act(self, state: RobotState, lap: Callable[[str], None] | None = None) -> PolicyOutput:
        """One control tick at phase min(1, k dt / duration)."""
        tick, phase = self.tick, min(1.0, self.tick * self.period_s / self.duration_s)
        self.tick += 1
        return self._controller.act(
            state.imu_quat_wxyz, state.imu_ang_vel_b, state.joint_pos_rad, state.joint_vel_rad_s, phase, lap,
            reference=self.reference, tick=tick,
        )  # fmt: skip

    def obstacle(self, state: RobotState) -> str | None:
        """Why this actor may not take over from this state, or None where it may."""
        entry = self._entry
        distance = np.abs(state.joint_pos_rad - self.start_pose_rad)
        joint = int(np.argmax(distance))
        if not distance[joint] <= entry.joint_rad:
            name = self._joint_names[joint]
            return f"{name} is {distance[joint]:.2f} rad from the start pose of {self.name}, limit {entry.joint_rad}"
        return unsteady(state, entry)


def asked_by(reference: Reference) -> tuple[Asked, ...]:
    """What a clip asks of the body at each of its K+1 ticks."""
    ang_vel_b = quat_rotate_inverse(reference.root_quat_wxyz, reference.root_ang_vel_w)
    rows = zip(map(up_in_base, reference.root_quat_wxyz), ang_vel_b, reference.joint_vel_rad_s, strict=True)
    return tuple(Asked(*row) for row in rows)


def unsteady(state: RobotState, entry: EntrySettings) -> str | None:
    """Why the base does not rest upright enough to hand over, or None."""
    tilt, spin = tilt_rad(state.imu_quat_wxyz), math.dist(state.imu_ang_vel_b.tolist(), (0.0, 0.0, 0.0))
    if not tilt < entry.tilt_rad:
        return f"tilt {tilt:.2f} rad, limit {entry.tilt_rad}"
    if not spin < entry.ang_vel_rad_s:
        return f"the base turns at {spin:.2f} rad/s, limit {entry.ang_vel_rad_s}"
    return None
