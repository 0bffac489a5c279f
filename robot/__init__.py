"""What is true of a robot: model, joint table, kinematics."""
