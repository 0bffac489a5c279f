"""One actor in the loop: robot state in, joint targets out, everything mapped by joint name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from core.errors import InputError
from policy.action import decode_action
from policy.actor import Actor
from policy.history import ObservationHistory
from policy.observation import ObservationInput, sample_terms, term_dims
from robot.robot import Robot


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


class PolicyController:
    """Runs ``actor`` on ``robot`` and keeps what an actor remembers: history and raw last action.

    A state that is not finite gives an action of NaN, whatever the graph or the clipping would make of
    it, so that the safety rule on actions sees it; from then on only ``reset`` helps.
    InputError if the joint names of actor and robot differ.
    """

    def __init__(self, actor: Actor, robot: Robot) -> None:
        spec = actor.spec
        if set(spec.joint_names) != set(robot.joint_names):
            differing = ", ".join(sorted(set(spec.joint_names) ^ set(robot.joint_names)))
            raise InputError("the joints of actor and robot differ", where=actor.path, got=differing)
        self.actor = actor
        self._to_robot = robot.joint_index(spec.joint_names)
        self._to_actor = np.argsort(self._to_robot)
        dims = term_dims(spec.num_joints)
        self._histories = {
            group.name: ObservationHistory(group, dims, spec.history_start) for group in spec.observations
        }
        self._kp = self._robot_order(spec.kp)
        self._kd = self._robot_order(spec.kd)
        self._last_action = np.zeros(spec.num_joints)

    def reset(self) -> None:
        """Forget the past: history as the spec starts it, last action zero."""
        for history in self._histories.values():
            history.reset()
        self._last_action = np.zeros(self.actor.spec.num_joints)

    def act(
        self,
        base_quat_wxyz: np.ndarray,
        base_ang_vel_b: np.ndarray,
        joint_pos_rad: np.ndarray,
        joint_vel_rad_s: np.ndarray,
        phase: float,
        lap: Callable[[str], None] | None = None,
    ) -> PolicyOutput:
        """One control tick. (4,), (3,) rad/s in the base frame, (J,), (J,) and the motion phase in [0, 1].

        ``lap`` is called with "observe" and "infer" as these parts end, for whoever times them.
        """
        spec = self.actor.spec
        state = ObservationInput(
            base_quat_wxyz=np.asarray(base_quat_wxyz, np.float64),
            base_ang_vel_b=np.asarray(base_ang_vel_b, np.float64),
            joint_pos_rad=np.asarray(joint_pos_rad, np.float64)[self._to_actor],
            joint_vel_rad_s=np.asarray(joint_vel_rad_s, np.float64)[self._to_actor],
            last_action=self._last_action,
            phase=np.array([phase], np.float64),
            default_pos_rad=spec.default_pos_rad,
        )
        samples = {name: sample_terms(history.terms, state) for name, history in self._histories.items()}
        observation = {name: self._histories[name].push(sample) for name, sample in samples.items()}
        if lap is not None:
            lap("observe")
        action = self.actor.infer(observation)
        if lap is not None:
            lap("infer")
        if not all(np.isfinite(sample).all() for sample in samples.values()):
            action = np.full_like(action, np.nan)
        self._last_action = action.astype(np.float64)
        target = decode_action(self._last_action, spec.default_pos_rad, spec.action_scale, spec.action_clip)
        return PolicyOutput(
            action=self._robot_order(action),
            target_rad=self._robot_order(target),
            kp=self._kp,
            kd=self._kd,
            observation=observation,
        )

    def _robot_order(self, values: np.ndarray) -> np.ndarray:
        ordered = values[self._to_robot]
        ordered.setflags(write=False)
        return ordered
