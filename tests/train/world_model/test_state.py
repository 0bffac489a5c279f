"""How states follow from each other, against MuJoCo's own integration."""

import mujoco
import numpy as np
import pytest
import torch

from core.rotations import quat_rotate
from robot.robot import load_robot
from train.world_model.state import Change, Motion, advanced, change_between, error, pack, unpack

DT_S = 0.02


def random_motion(generator, robots=5, joints=23):
    def draw(*shape, std=1.0):
        return std * torch.randn(*shape, generator=generator, dtype=torch.float64)

    quat = draw(robots, 4)
    return Motion(
        draw(robots, 3), quat / quat.norm(dim=1, keepdim=True), draw(robots, 3), draw(robots, 3, std=3.0),
        draw(robots, joints), draw(robots, joints, std=5.0),
    )  # fmt: skip


def test_the_change_between_two_states_leads_from_one_to_the_other():
    generator = torch.Generator().manual_seed(1)
    before, after = random_motion(generator), random_motion(generator)
    reached = advanced(before, change_between(before, after, DT_S), DT_S)
    assert pack(error(reached, after)).abs().max() < 1e-9


def test_with_constant_velocities_a_step_is_mujocos():
    """MuJoCo takes the linear velocity in the world, the angular one in the body's frame, as kata does."""
    model = load_robot().model
    motion = random_motion(torch.Generator().manual_seed(2))
    still = Change(
        *(torch.zeros_like(part) for part in (motion[2], motion[3], motion[5], motion[2], motion[3], motion[4]))
    )
    reached = advanced(motion, still, DT_S)
    world = quat_rotate(motion.quat_wxyz, motion.lin_vel_b)
    for i in range(len(motion.pos_w)):
        qpos = np.concatenate([motion.pos_w[i], motion.quat_wxyz[i], motion.joint_pos_rad[i]])
        qvel = np.concatenate([world[i], motion.ang_vel_b[i], motion.joint_vel_rad_s[i]])
        mujoco.mj_integratePos(model, qpos, qvel, DT_S)
        assert reached.pos_w[i].numpy() == pytest.approx(qpos[:3], abs=1e-12)
        assert abs(np.dot(reached.quat_wxyz[i].numpy(), qpos[3:7])) == pytest.approx(1.0, abs=1e-12)
        assert reached.joint_pos_rad[i].numpy() == pytest.approx(qpos[7:], abs=1e-12)


def test_packing_keeps_every_part():
    motion = random_motion(torch.Generator().manual_seed(3))
    assert all(torch.equal(a, b) for a, b in zip(motion, unpack(pack(motion)), strict=True))


def test_the_error_of_a_small_turn_is_its_rotation_vector():
    upright = random_motion(torch.Generator().manual_seed(4))
    turned = upright._replace(quat_wxyz=torch.tensor([[np.cos(0.005), 0.0, np.sin(0.005), 0.0]]).double().repeat(5, 1))
    level = upright._replace(quat_wxyz=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).double().repeat(5, 1))
    assert error(turned, level).quat_wxyz[0].tolist() == pytest.approx([0.0, 0.01, 0.0], abs=1e-6)
