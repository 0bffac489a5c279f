"""Readers of other people's actors into this project's spec."""
