"""From human motion to a robot's: inverse kinematics that keeps contacts, limits and distances."""
