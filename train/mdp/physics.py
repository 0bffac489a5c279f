"""The simulator as the environment sees it: the one place where numbers cross between its memory and the device."""

import torch

from core.rotations import quat_rotate
from robot.robot import Robot
from train.batch import Device
from train.mdp.tick import Bodies
from train.simulation.domain import Domain
from train.simulation.simulator import PhysicsState, Simulator


class Physics:
    """A simulator whose states come, and whose commands go, on ``device``; and the points that are tracked."""

    def __init__(self, simulator: Simulator, robot: Robot, device: Device) -> None:
        self.simulator, self._kinematics, self._device = simulator, robot.kinematics, device

    @property
    def domain(self) -> Domain:
        """Physical parameters of the present robots."""
        return self.simulator.domain.to(self._device)

    @property
    def delay_s(self) -> torch.Tensor:
        """(B,) control delay of the present episodes, seconds."""
        return self.simulator.delay_s.to(self._device)

    def state(self) -> PhysicsState:
        """See :class:`train.simulation.simulator.Simulator`."""
        return self.simulator.state().to(self._device)

    def step(self, targets: torch.Tensor) -> None:
        """See :class:`train.simulation.simulator.Simulator`."""
        self.simulator.step(targets.cpu())

    def reset(self, env_ids: torch.Tensor, qpos: torch.Tensor, qvel: torch.Tensor) -> None:
        """See :class:`train.simulation.simulator.Simulator`."""
        self.simulator.reset(env_ids.cpu(), qpos.cpu(), qvel.cpu())

    def push(self, env_ids: torch.Tensor, velocity_w: torch.Tensor) -> None:
        """See :class:`train.simulation.simulator.Simulator`."""
        self.simulator.push(env_ids.cpu(), velocity_w.cpu())

    def bodies(self, state: PhysicsState) -> Bodies:
        """World poses and velocities of the tracked points of robots in these states.

        By numpy, whose operations on a few hundred robots start in half of torch's time.
        """
        ang_vel_w = quat_rotate(state.root_quat_wxyz, state.root_ang_vel_b)
        values = (
            state.root_pos_w, state.root_quat_wxyz, state.joint_pos_rad, state.root_lin_vel_w, ang_vel_w,
            state.joint_vel_rad_s,
        )  # fmt: skip
        found = self._kinematics.forward(*(value.cpu().numpy() for value in values))
        return Bodies(*(torch.from_numpy(value).to(self._device) for value in found))
