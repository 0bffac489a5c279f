"""One simulated robot in real time, moved by what its emulated devices are told."""

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from core import robot_time as time
from hal.emulator.checks import CommandChecks, Index
from hal.emulator.fair_lock import FairLock
from hal.emulator.faults import Faults
from hal.emulator.lean import Lean
from robot.robot import Robot
from world.actuation import JointCommand
from world.gantry import NEVER, Gantry, hang_up
from world.options import SimOptions, load_sim_options
from world.plant import Measurement, Plant, TrueState
from world.plant_model import build_plant_model
from world.randomization import draw_conditions
from world.scene import FLAT, Scene

WAKE_PERIOD_S = 0.005
LATE_S = 0.01
STEP_TOLERANCE = 1e-6
SLACK, DAMPED, DRIVEN = "slack", "damped", "driven"

Values = tuple[float, float, float, float, float, float]
"""What a motor is told, in joint coordinates: q (rad), dq (rad/s), kp, kd, tau (Nm), and its own torque limit (Nm)."""
NO_TORQUE: Values = (0.0, 0.0, 0.0, 0.0, 0.0, math.inf)


class _Order(NamedTuple):
    """A motor's new command, from a step on."""

    step: int
    time_s: float
    joint: int
    values: Values


class Joints(NamedTuple):
    """Plain numbers in joint order: rad, rad/s, Nm."""

    pos_rad: list[float]
    vel_rad_s: list[float]
    torque_nm: list[float]


class EmulatedRobot:
    """Physics that follows the machine's monotonic clock, shared by the devices of one emulator. Thread-safe.

    The motors' law is torque = clip(kp (q* - q) + kd (dq* - dq) + tau, limit), evaluated at every physics step with
    the newest command that had arrived when the step began, in joint coordinates: the same plant and the same law as
    in the simulated backend. Nothing is skipped: whoever asks first brings the physics to now, and a thread of its own
    does so every 5 ms. Who does several things at one moment holds `lock` meanwhile. The robot begins slack, hanging
    on its gantry, feet on the ground of `scene`; motors without a command give no torque. Delays and noise of `sim` are
    not used here. start_noise_rad: std of a normal added to each joint's start. now: the clock, seconds.
    """

    def __init__(
        self,
        robot: Robot,
        faults: Faults | None = None,
        sim: SimOptions | None = None,
        *,
        scene: Scene = FLAT,
        start_noise_rad: float = 0.0,
        seed: int = 0,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        options = load_sim_options() if sim is None else sim
        self.robot, self.faults = robot, Faults() if faults is None else faults
        self.timestep_s = options.timestep_s
        self.failure: Exception | None = None
        self._now = now
        self._plant = Plant(robot, build_plant_model(robot, options, scene=scene, gantry=True), scene)
        self._conditions = draw_conditions(options, robot, np.random.default_rng(seed))
        self._plant.vary(self._conditions)
        self._gantry = Gantry(self._plant.model, self._plant.data, options.gantry)
        self.checks = CommandChecks(robot.joint_names, robot.torque_limit_nm)
        self._stuck, self._jammed = np.zeros(robot.num_joints, dtype=bool), False
        self.lock = FairLock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.reset(start_noise_rad=start_noise_rad, seed=seed)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """In the order of every (J,) array."""
        return self.robot.joint_names

    def start(self) -> None:
        """Let time run. The clock starts now."""
        with self.lock:
            self._start_s += self._now() - self._time_s(self._step)
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop time. May be repeated."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def reset(self, *, start_noise_rad: float = 0.0, seed: int = 0, lift_m: float = 0.0) -> None:
        """Hang it up anew, slack and at rest; violations and lateness are forgotten. lift_m: above the ground."""
        robot, joints = self.robot, self.robot.num_joints
        noise = np.random.default_rng(seed).normal(0.0, start_noise_rad, joints)
        with self.lock:
            hang_up(self._plant, self._gantry, robot.default_pos_rad + noise, lift_m=lift_m)
            self._start_s, self._step = self._now(), 0
            self._orders: deque[_Order] = deque()
            self._in_force: list[Values] = [NO_TORQUE] * joints
            self._plant.cap(robot.torque_limit_nm)
            self._lean = Lean()
            self._told_s = np.full(joints, -np.inf)
            self._modes = np.zeros(joints, dtype=int)  # index into SLACK, DAMPED, DRIVEN
            self._since_s = np.full(joints, self._start_s)
            self._seen: tuple[int, Measurement] | None = None
            self._seen_joints: tuple[int, Joints] | None = None
            self._late_steps, self._worst_late_s = 0, 0.0
            self.checks.reset()

    def command(
        self,
        joint: int,
        q_rad: float,
        dq_rad_s: float,
        kp: float,
        kd: float,
        tau_nm: float,
        limit_nm: float = math.inf,
    ) -> None:
        """A motor has been told something, in joint coordinates. limit_nm: below the joint's own limit, if any.

        A command that is not finite, or whose gains lie outside `checks.kp_max` and `kd_max`, is counted as a
        violation and not obeyed; one that asks for too much torque is counted and obeyed, clipped.
        """
        values = (float(q_rad), float(dq_rad_s), float(kp), float(kd), float(tau_nm), float(limit_nm))
        self.command_all([(joint, values)])

    def command_all(self, told: Iterable[tuple[int, Values]]) -> None:
        """Several motors, by their joints, have been told something in one frame. See `command`."""
        now_s = self._now()
        with self.lock:
            step = self._step_at(now_s)
            for joint, values in told:
                if not math.isfinite(sum(values[:5])) or math.isnan(values[5]):
                    self.checks.add(now_s, "not_finite", joint, str(values))
                elif self.checks.judge_gains(now_s, joint, values[2], values[3]):
                    self._orders.append(_Order(step, now_s, joint, values))

    def slack(self, joint: int) -> None:
        """A motor gives no torque from now on."""
        self.command_all([(joint, NO_TORQUE)])

    def measure(self) -> Measurement:
        """What ideal sensors read now, to the millisecond; `time_s` is monotonic. Not to be written to."""
        with self.lock:
            self._advance(self._now())
            if self._seen is None or self._seen[0] != self._step:
                self._seen = (self._step, self._lean.seen(self._plant.measure(self._time_s(self._step))))
            return self._seen[1]

    def joints(self) -> Joints:
        """Position, speed and torque of every joint now, as `measure` gives them: the part that a servo knows."""
        seen = self._seen_joints
        if seen is not None and seen[0] == self._step_at(self._now()):  # many servos ask within one step
            return seen[1]
        with self.lock:
            self._advance(self._now())
            if self._seen_joints is None or self._seen_joints[0] != self._step:
                self._seen_joints = (self._step, Joints(*(values.tolist() for values in self._plant.joints())))
            return self._seen_joints[1]

    def report(self, joint: Index, pos_rad: float | np.ndarray, vel_rad_s: float | np.ndarray) -> None:
        """A device has put this state of one joint, or of several, on the wire: what later commands are judged by."""
        with self.lock:
            self.checks.report(joint, self._now(), pos_rad, vel_rad_s)

    def truth(self) -> TrueState:
        """The state itself, now."""
        with self.lock:
            self._advance(self._now())
            return self._plant.truth()

    @property
    def gantry_attached(self) -> bool:
        """Whether the gantry pulls, the ramp after a release included."""
        with self.lock:
            self._advance(self._now())
            return self._gantry.attached

    def lean(self, forwards_rad: float, left_rad: float, takes_s: float = 1.0) -> None:
        """Lean the base, gantry and all, and hold it there; 0, 0 sets it upright."""
        with self.lock:
            self._lean.to(forwards_rad, left_rad, self._now(), takes_s)

    def release_gantry(self) -> None:
        """Let go gently."""
        with self.lock:
            self._advance(self._now())
            self._gantry.release(self._step)

    def status(self) -> dict[str, Any]:
        """Plain data: truth, gantry, lateness, violations, and what each motor was last told. Times: monotonic."""
        with self.lock:
            truth = self.truth()
            names, modes = self.joint_names, (SLACK, DAMPED, DRIVEN)
            return {
                "time_s": self._time_s(self._step),
                "gantry_attached": self._gantry.attached,
                "root_pos_w": truth.root_pos_w.tolist(),
                "root_quat_wxyz": truth.root_quat_wxyz.tolist(),
                "root_lin_vel_w": truth.root_lin_vel_w.tolist(),
                "root_ang_vel_b": truth.root_ang_vel_b.tolist(),
                "joint_pos_rad": dict(zip(names, truth.joint_pos_rad.tolist())),
                "joint_vel_rad_s": dict(zip(names, truth.joint_vel_rad_s.tolist())),
                "mode": {name: modes[mode] for name, mode in zip(names, self._modes.tolist())},
                "mode_since_s": dict(zip(names, self._since_s.tolist())),
                "told_s": {name: None if t < 0 else t for name, t in zip(names, self._told_s.tolist())},
                "late": {"wakes_over_10_ms": self._late_steps, "worst_ms": self._worst_late_s * 1e3},
                "violations": self.checks.summary(),
            }

    def _run(self) -> None:
        tick, start_s = 0, time.monotonic()
        try:
            while not self._stop.is_set():
                with self.lock:
                    now_s = self._now()
                    late_s = now_s - self._time_s(self._step)
                    self._worst_late_s = max(self._worst_late_s, late_s)
                    self._late_steps += late_s > LATE_S
                    self._advance(now_s)
                tick = max(tick + 1, int((time.monotonic() - start_s) / WAKE_PERIOD_S))
                time.sleep(max(0.0, start_s + tick * WAKE_PERIOD_S - time.monotonic()))
        except Exception as error:
            self.failure = error
            raise

    def _advance(self, now_s: float) -> None:
        if self._thread is None:
            return
        self._jam()
        target = self._step_at(now_s)
        while self._step < target:
            self._obey()
            if self._gantry.at <= self._step:
                self._gantry.act(self._step)
            until = min(target, self._gantry.at, self._orders[0].step if self._orders else NEVER)
            self._plant.step(until - self._step)
            self._step = until
        if not np.isfinite(self._plant.data.qacc).all():
            raise FloatingPointError(f"physics diverged at {self._time_s(self._step):.3f} s")

    def _obey(self) -> None:
        """Put the commands that have arrived in force."""
        changed: list[int] = []
        while self._orders and self._orders[0].step <= self._step:
            order = self._orders.popleft()
            self._told_s[order.joint] = time_s = order.time_s
            self._set_mode(order)
            if order.values != self._in_force[order.joint]:
                self._in_force[order.joint] = order.values
                changed.append(order.joint)
        if not changed:
            return
        table = np.array(self._in_force).T
        self.checks.judge_torque(time_s, np.array(changed), table[:5])
        self._plant.cap(np.minimum(table[5], self.robot.torque_limit_nm))
        self._plant.drive(JointCommand(*table[:5]), self._conditions.kp_scale, self._conditions.kd_scale)

    def _set_mode(self, order: _Order) -> None:
        q_rad, dq_rad_s, kp, kd, tau_nm, _ = order.values
        mode = 2 if kp or tau_nm or (kd and dq_rad_s) else int(kd > 0)
        if mode != self._modes[order.joint]:
            self._modes[order.joint], self._since_s[order.joint] = mode, order.time_s
            if mode == 2:
                self.checks.take_up(order.joint, q_rad, kp, self._in_force[order.joint])

    def _jam(self) -> None:
        """Joints stuck by a fault, and free again."""
        if not (self._jammed or self.faults.any_active):
            return
        stuck = self.faults.struck("stuck_joint", self.joint_names)
        if not np.array_equal(stuck, self._stuck):
            self._plant.jam(stuck)
            self._stuck, self._jammed = stuck, bool(stuck.any())

    def _time_s(self, step: int) -> float:
        return self._start_s + step * self.timestep_s

    def _step_at(self, time_s: float) -> int:
        return max(self._step, int((time_s - self._start_s) / self.timestep_s + STEP_TOLERANCE))
