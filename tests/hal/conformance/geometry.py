"""A wire's bundled robot with its servos built in otherwise: turned round, off zero, behind other gears."""

from pathlib import Path

import numpy as np
from omegaconf import OmegaConf

from hal.open import wire_config
from robot.robot import Robot

# wire -> where its file lists the servos; a wire that is not here has no geometry of its own.
SERVOS = {"can": "motors", "dynamixel": "servos"}
ZERO_RAD, GEAR = 3.0, 1.4
TURN_RAD, MARGIN_RAD = 2.0 * np.pi, 0.2


def built_otherwise(wire: str, robot: Robot, seed: int, folder: Path) -> Path:
    """A file for both ends: every servo with a random direction, zero and gear, so that its turn can still be found."""
    rng = np.random.default_rng(seed)
    content = OmegaConf.load(wire_config(wire))
    for servo in content[SERVOS[wire]]:
        joint = robot.joint_names.index(servo.joint)
        range_rad = float(robot.pos_upper_rad[joint] - robot.pos_lower_rad[joint]) + 2.0 * MARGIN_RAD
        servo.direction = int(rng.choice((-1, 1)))
        servo.zero_rad = float(rng.uniform(-ZERO_RAD, ZERO_RAD))
        servo.gear = float(rng.uniform(1.0, min(GEAR, TURN_RAD / range_rad)))
    path = folder / f"{wire}_{seed}.yaml"
    OmegaConf.save(content, path)
    return path
