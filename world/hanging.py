"""How a simulated robot is hung up on its gantry."""

import numpy as np

from world.gantry import Gantry
from world.plant import Plant

UPRIGHT_WXYZ = np.array([1.0, 0.0, 0.0, 0.0])


def hang_up(plant: Plant, gantry: Gantry, joint_pos_rad: np.ndarray) -> None:
    """At rest and slack in a joint pose (J,), feet on the ground; the straps are set for the default pose."""
    pose = plant.robot.default_pos_rad
    height_m = plant.standing_height_m(pose)
    plant.place(np.array([0.0, 0.0, height_m]), UPRIGHT_WXYZ, pose)
    gantry.hang_at_present_pose()
    height_m = max(height_m, plant.standing_height_m(joint_pos_rad))
    plant.place(np.array([0.0, 0.0, height_m]), UPRIGHT_WXYZ, joint_pos_rad)
