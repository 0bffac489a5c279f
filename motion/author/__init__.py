"""Clips written by hand: a choreography (YAML) of body targets becomes a clip by inverse kinematics."""
