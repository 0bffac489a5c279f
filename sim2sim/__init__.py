"""Scores an actor in simulation."""
