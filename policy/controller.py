"""One actor in the loop: robot state in, joint targets out, everything mapped by joint name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from core.errors import InputError
from core.rotations import projected_gravity
from policy.action import decode_action
from policy.actor import Actor
from policy.attitude import filtered_gravity
from policy.goals import visible_in
from policy.history import ObservationHistory
from policy.observation import asks_for, bodies_looked_at, sample_terms, spec_dims, window_ticks
from policy.reference import ReferenceMotion, ReferenceWindow, heading_difference_rad, window_at
from policy.terms import ObservationInput
from robot.robot import Robot

EVERYTHING = visible_in("full")
NORTH = np.array([1.0, 0.0, 0.0, 0.0])  # heading 0


@dataclass(frozen=True, eq=False)
class PolicyOutput:
    """One tick of an actor. Joint arrays are (J,) in the robot's joint order.

    ``action`` is the graph's raw output; ``observation`` holds, per group, what went into the graph.
    """

    action: np.ndarray  # (J,) float32
    target_rad: np.ndarray
    kp: np.ndarray
    kd: np.ndarray
    observation: dict[str, np.ndarray]  # (n,) float32 each


@dataclass(frozen=True, eq=False)
class Given:
    """The latest values (n,) of a command or a map, and how old they are."""

    values: np.ndarray
    age_s: float


class PolicyController:
    """Runs ``actor`` on ``robot`` and keeps what an actor remembers: history, raw last action, the graph's own state.

    A state that is not finite gives an action of NaN, whatever the graph or the clipping would make of
    it, so that the safety rule on actions sees it; from then on only ``reset`` helps. A map that is missing or too old
    does the same; a command that is missing or too old is at rest, and none leaves the range seen in training.
    """

    def __init__(self, actor: Actor, robot: Robot) -> None:
        spec = actor.spec
        names = (*spec.joint_names, *(joint.name for joint in spec.held_joints))
        if set(names) != set(robot.joint_names):
            differing = ", ".join(sorted(set(names) ^ set(robot.joint_names)))
            raise InputError("the joints of actor and robot differ", where=actor.path, got=differing)
        self.actor = actor
        self._to_robot = robot.joint_index(names)
        self._to_actor = np.argsort(self._to_robot)[: spec.num_joints]
        dims = spec_dims(spec)
        self._histories = {
            group.name: ObservationHistory(group, dims, spec.history_start) for group in spec.observations
        }
        self.window_ticks = window_ticks(spec.observations)
        follows_goals = asks_for(spec.observations, "goal_visible")
        self._filters = asks_for(spec.observations, "filtered_gravity")
        self._points = robot.tracked_index(robot.goal_points) if follows_goals else None
        bodies = bodies_looked_at(spec.observations)
        self._bodies = dict(zip(bodies, robot.body_index(bodies).tolist()))
        self._robot = robot
        self._kp = self._robot_order(spec.kp, [joint.kp for joint in spec.held_joints])
        self._kd = self._robot_order(spec.kd, [joint.kd for joint in spec.held_joints])
        self._held_rad = [joint.pos_rad for joint in spec.held_joints]
        self.reset()

    def reset(self) -> None:
        """Forget the past: history as the spec starts it, last action and the graph's state zero, heading open."""
        for history in self._histories.values():
            history.reset()
        self._last_action = np.zeros(self.actor.spec.num_joints)
        self._state = self.actor.start_state()
        self._turn_rad: float | None = None
        self._gravity_b, self._ticks = np.zeros(3), 0

    def act(
        self,
        base_quat_wxyz: np.ndarray,
        base_ang_vel_b: np.ndarray,
        joint_pos_rad: np.ndarray,
        joint_vel_rad_s: np.ndarray,
        phase: float,
        lap: Callable[[str], None] | None = None,
        *,
        reference: ReferenceMotion | None = None,
        tick: int = 0,
        visible: np.ndarray = EVERYTHING,
        turn_rad: float | None = None,
        given: Mapping[str, Given] = MappingProxyType({}),
    ) -> PolicyOutput:
        """One control tick. (4,), (3,) rad/s in the base frame, (J,), (J,) and the motion phase in [0, 1].

        ``lap`` is called with "observe" and "infer" as these parts end, for whoever times them. ``reference``: the
        clip, for an actor that looks ahead, and the ``tick`` of it that is now; its heading becomes the robot's at the
        first call after ``reset``. ``visible`` (V,): which parts of it an actor that follows goals is shown, of
        :data:`policy.goals.PARTS`. ``turn_rad``: by how much the reference is turned besides, where heading 0 becomes
        the robot's at that call, not the reference's own. ``given``: commands and maps by name.
        """
        base_quat = np.asarray(base_quat_wxyz, np.float64)
        ang_vel_b = np.asarray(base_ang_vel_b, np.float64)
        seen = ObservationInput(
            base_quat_wxyz=base_quat,
            base_ang_vel_b=ang_vel_b,
            joint_pos_rad=np.asarray(joint_pos_rad, np.float64)[self._to_actor],
            joint_vel_rad_s=np.asarray(joint_vel_rad_s, np.float64)[self._to_actor],
            last_action=self._last_action,
            phase=np.array([phase], np.float64),
            default_pos_rad=self.actor.spec.default_pos_rad,
            filtered_gravity_b=self._filter(base_quat, ang_vel_b),
            bodies_quat_wxyz=self._turned(base_quat, joint_pos_rad),
            reference=self._window(base_quat, reference, tick, visible, turn_rad),
            given=self._given(given),
        )
        return self._infer(self._samples(seen), lap or _no_lap)

    def _samples(self, state: ObservationInput) -> dict[str, np.ndarray]:
        return {name: sample_terms(history.terms, state) for name, history in self._histories.items()}

    def _filter(self, base_quat: np.ndarray, ang_vel_b: np.ndarray) -> np.ndarray | None:
        """Direction of gravity (3,) in the base frame, with all that was measured since the last ``reset``."""
        if not self._filters:
            return None
        measured, ticks = projected_gravity(base_quat), np.array(float(self._ticks))
        period_s = self.actor.spec.control_period_s
        self._gravity_b = filtered_gravity(self._gravity_b, measured, ang_vel_b, ticks, period_s)
        self._ticks += 1
        return self._gravity_b

    def _infer(self, samples: Mapping[str, np.ndarray], lap: Callable[[str], None]) -> PolicyOutput:
        """Observe and ask the graph."""
        spec = self.actor.spec
        observation = {name: self._histories[name].push(sample) for name, sample in samples.items()}
        lap("observe")
        action, self._state = self.actor.infer(observation, self._state)
        lap("infer")
        if not all(np.isfinite(sample).all() for sample in samples.values()):
            action = np.full_like(action, np.nan)
        self._last_action = action.astype(np.float64)
        target = decode_action(self._last_action, spec.default_pos_rad, spec.action_scale, spec.action_clip)
        return PolicyOutput(
            action=self._robot_order(action, np.zeros(len(self._held_rad))),
            target_rad=self._robot_order(target, self._held_rad),
            kp=self._kp,
            kd=self._kd,
            observation=observation,
        )

    def _window(
        self,
        base_quat: np.ndarray,
        reference: ReferenceMotion | None,
        tick: int,
        visible: np.ndarray,
        turn_rad: float | None,
    ) -> ReferenceWindow | None:
        if not self.window_ticks or reference is None:
            return None
        if self._turn_rad is None:
            here = min(tick, len(reference.root_quat_wxyz) - 1)
            own = NORTH if turn_rad is not None else reference.root_quat_wxyz[here]
            self._turn_rad = heading_difference_rad(base_quat, own)
        turn = self._turn_rad + (turn_rad or 0.0)
        return window_at(
            reference, tick, self.window_ticks, self._to_actor, turn, self._points, visible, bodies=self._bodies
        )

    def _turned(self, base_quat: np.ndarray, joint_pos_rad: np.ndarray) -> dict[str, np.ndarray]:
        """How the bodies that terms look at are turned (4,), by the IMU and the joints."""
        if not self._bodies:
            return {}
        joints = np.asarray(joint_pos_rad, np.float64)
        quats = self._robot.kinematics.forward(np.zeros(3), base_quat, joints).quat_wxyz
        return {name: quats[column] for name, column in self._bodies.items()}

    def _given(self, given: Mapping[str, Given]) -> dict[str, np.ndarray]:
        """What is in force of commands and maps."""
        values = {}
        for command in self.actor.spec.commands:
            latest = given.get(command.name)
            fresh = latest is not None and latest.age_s <= command.timeout_s
            wanted = np.asarray(latest.values if latest and fresh else command.rest, np.float64)
            values[command.name] = np.clip(wanted, *np.transpose(command.range))
        for grid in self.actor.spec.maps:
            latest = given.get(grid.name)
            if latest is None or not latest.age_s <= grid.max_age_s:
                values[grid.name] = np.full(len(grid.x_m) * len(grid.y_m), np.nan)
            else:
                values[grid.name] = np.clip(np.asarray(latest.values, np.float64), -grid.clip_m, grid.clip_m)
        return values

    def _robot_order(self, moved: np.ndarray, held: Sequence[float] | np.ndarray) -> np.ndarray:
        """Values of moved and held joints (J,) in the robot's order."""
        ordered = np.concatenate([moved, held]).astype(moved.dtype)[self._to_robot]
        ordered.setflags(write=False)
        return ordered


def _no_lap(phase: str) -> None:
    """Nobody times the parts."""
