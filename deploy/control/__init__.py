"""The loop, its tick, and the states of a running robot."""
