"""The control loop, its states and its safety rules."""
