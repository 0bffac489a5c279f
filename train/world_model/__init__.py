"""Learning through a world model: one control step of the robot, learnt from the simulator, that gradients pass."""
