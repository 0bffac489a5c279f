"""The robot in MuJoCo, behind the same interface as the real one."""

from collections import deque
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from core.clock import Clock
from hal.contract.backend import Backend
from hal.contract.dead_man import DeadMan
from hal.contract.types import DeviceInfo, LinkLost, NoState, RobotState
from robot.robot import Robot
from world.actuation import JointCommand, damping_command
from world.disturbance import CommandLine, Event, Pushes, TorqueNoise
from world.gantry import NEVER, UPRIGHT_WXYZ, Gantry, hang_up
from world.options import SimOptions
from world.plant import Measurement, Plant
from world.plant_model import build_plant_model
from world.randomization import Conditions, draw_conditions
from world.scene import FLAT, Scene
from world.sensor_noise import add_noise

STEP_TOLERANCE = 1e-6


class MujocoBackend(Backend):
    """Physics that follows the clock: every read and write first advances it to now, so it runs in real time on the
    machine's clock and as fast as it can on a simulated one.

    The motors are explicit PD at every step, clipped at the torque limits; the sender's dead man is part of the
    simulated device. With `gantry` the robot begins slack, hanging on the gantry; otherwise it begins slack in
    its default pose on the ground. `reset_to` begins a new episode anywhere. Each episode is drawn from its generator.
    Damping frame: kp = 0, the robot's damping kd, clipped like any other torque. `on_advance(model, data)` is called
    whenever the physics has caught up with the clock, for a viewer.
    """

    def __init__(
        self,
        robot: Robot,
        clock: Clock,
        options: SimOptions,
        *,
        control_period_s: float = 0.02,
        scene: Scene = FLAT,
        sim_model: Path | None = None,
        gantry: bool = True,
        meshes: Path | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        super().__init__(clock, control_period_s)
        self.robot, self.options = robot, options
        self.on_advance: Callable[[mujoco.MjModel, mujoco.MjData], None] | None = None
        self._sim_model = sim_model
        model = build_plant_model(robot, options, scene=scene, sim_model=sim_model, gantry=gantry, meshes=meshes)
        self._plant = Plant(robot, model, scene)
        self._gantry = Gantry(self._plant.model, self._plant.data, options.gantry) if gantry else None
        self._damping = damping_command(robot.damping_kd)
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._dead_man = DeadMan(control_period_s)
        self.conditions: Conditions = draw_conditions(options, robot, self._rng)
        self._begin()

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model, for pictures."""
        return self._plant.model

    @property
    def data(self) -> mujoco.MjData:
        """The present state, for pictures."""
        return self._plant.data

    @property
    def scene(self) -> Scene:
        """What the robot stands in."""
        return self._plant.scene

    @property
    def gantry_attached(self) -> bool:
        """See Supported."""
        return self._gantry is not None and self._gantry.attached

    def release_gantry(self) -> None:
        """See Supported."""
        self._advance()
        if self._gantry is not None:
            self._gantry.release(self._step)

    def open(self) -> DeviceInfo:
        """Begin the first episode, slack: on the gantry where there is one, otherwise on the ground."""
        self._is_open = True
        if self._gantry is not None:
            self.hang()
        else:
            pose = self.robot.default_pos_rad
            height_m = self._plant.standing_height_m(pose)
            self.reset_to(np.array([0.0, 0.0, height_m]), UPRIGHT_WXYZ, pose)
        details = {
            "physics": f"MuJoCo {mujoco.__version__}, {1.0 / self.options.timestep_s:g} Hz",
            "model": str(self._sim_model or self.robot.name),
            "gantry": "attached" if self.gantry_attached else "none",
        }
        return DeviceInfo("mujoco", self.robot.joint_names, watchdog="damps by itself", details=details)

    def hang(self, joint_pos_rad: np.ndarray | None = None, *, rng: np.random.Generator | None = None) -> None:
        """Begin an episode slack on the gantry, feet on the ground, in a joint pose (J,) (None: the default pose)."""
        if self._gantry is None:
            raise ValueError("mujoco: this backend was built without a gantry")
        self._draw(rng)
        hang_up(self._plant, self._gantry, self.robot.default_pos_rad if joint_pos_rad is None else joint_pos_rad)
        self._begin()

    def reset_to(
        self,
        root_pos_w: np.ndarray,
        root_quat_wxyz: np.ndarray,
        joint_pos_rad: np.ndarray,
        *,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Begin an episode at a pose (3,), (4,), (J,), at rest, slack, off the gantry. rng: its randomness."""
        self._draw(rng)
        if self._gantry is not None:
            self._gantry.drop()
        self._plant.place(root_pos_w, root_quat_wxyz, joint_pos_rad)
        self._begin()

    def read(self) -> RobotState:
        """See Backend."""
        self._require_open()
        self._advance()
        now_s = self.clock.now_s()
        seen = self._delayed(now_s) if self.options.state_delay_s else self._plant.measure(self._time_s(self._step))
        seen = add_noise(seen, self.conditions.noise, self._noise_rng)
        age_s = max(0.0, now_s - seen.time_s)
        return RobotState(
            time_s=now_s,
            joint_pos_rad=seen.joint_pos_rad,
            joint_vel_rad_s=seen.joint_vel_rad_s,
            joint_torque_nm=seen.joint_torque_nm,
            joint_age_s=np.full(self.robot.num_joints, age_s),
            imu_quat_wxyz=seen.imu_quat_wxyz,
            imu_ang_vel_b=seen.imu_ang_vel_b,
            imu_acc_b=seen.imu_acc_b,
            imu_age_s=age_s,
            faults=("dead_man",) if self._dead_man.latched else (),
            energised=self._energised,
            truth=self._plant.truth(),
        )

    def write(self, command: JointCommand) -> None:
        """See Backend."""
        self._require_open()
        if command.q_rad.size != self.robot.num_joints:
            raise ValueError(f"mujoco: got {command.q_rad.size} joints, expected {self.robot.num_joints}")
        self._advance()
        self._energised = True
        if self._dead_man.feed(self.clock.now_s()):
            self._line.send(self._step, command)
        else:
            self._line.cut(self._damping)

    def damp(self) -> None:
        """See Backend."""
        if not self._is_open:
            return
        self._advance()
        self._energised = True
        self._dead_man.disarm()
        self._line.send(self._step, self._damping)

    def acknowledge(self) -> None:
        """See Backend."""
        self._dead_man.acknowledge()

    def _disable(self) -> None:
        zero = np.zeros(self.robot.num_joints)
        self._line.cut(JointCommand(zero, zero, zero, zero, zero))

    def _require_open(self) -> None:
        if not self._is_open:
            raise LinkLost("mujoco: not open")

    def _draw(self, rng: np.random.Generator | None) -> None:
        if rng is not None:
            self._rng = rng
        self.conditions = draw_conditions(self.options, self.robot, self._rng)
        self._plant.vary(self.conditions)

    def _begin(self) -> None:
        """Start the episode's time, events and records at the plant's present pose, damped."""
        self._start_s, self._step = self.clock.now_s(), 0
        self._dead_man, self._energised = DeadMan(self.control_period_s), False
        self._line = CommandLine(self._plant, self.conditions)
        self._line.cut(self._damping)
        # One stream for each kind of noise, so that how often the state is read changes nothing else.
        push_rng, torque_rng, self._noise_rng = self._rng.spawn(3)
        hold_s = self.options.randomization.torque_noise_hold_s
        self._events: list[Event] = [
            self._line,
            Pushes(self._plant, self.conditions, push_rng, 0),
            TorqueNoise(self._plant, self.conditions, torque_rng, hold_s, 0),
        ]
        if self._gantry is not None:
            self._events.append(self._gantry)
        self._record: deque[Measurement] = deque()

    def _time_s(self, step: int) -> float:
        return self._start_s + step * self.options.timestep_s

    def _step_at(self, time_s: float) -> int:
        """The number of whole steps that have passed at a time."""
        return int((time_s - self._start_s) / self.options.timestep_s + STEP_TOLERANCE)

    def _advance(self) -> None:
        """Bring the physics to the clock's now; past the dead man's deadline the joints are damped."""
        now_s = self.clock.now_s()
        target, deadline_s = self._step_at(now_s), self._dead_man.deadline_s
        if now_s > deadline_s:
            self._run_to(min(target, self._step_at(deadline_s) + 1))
        if self._dead_man.expired(now_s):
            self._line.cut(self._damping)
        self._run_to(target)
        if self.on_advance is not None:
            self.on_advance(self._plant.model, self._plant.data)

    def _run_to(self, target: int) -> None:
        stride = 1 if self.options.state_delay_s else NEVER
        while self._step < target:
            for event in self._events:
                if event.at <= self._step:
                    event.act(self._step)
            until = min(target, self._step + stride, *(event.at for event in self._events))
            self._plant.step(until - self._step)
            self._step = until
            if self.options.state_delay_s:
                self._record.append(self._plant.measure(self._time_s(self._step)))

    def _delayed(self, now_s: float) -> Measurement:
        """The newest measurement that is at least the state delay old."""
        latest_s = now_s - self.options.state_delay_s + STEP_TOLERANCE
        while len(self._record) > 1 and self._record[1].time_s <= latest_s:
            self._record.popleft()
        if not self._record or self._record[0].time_s > latest_s:
            raise NoState("mujoco: no state has arrived yet")
        return self._record[0]
