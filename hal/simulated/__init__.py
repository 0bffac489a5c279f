"""Backends without a wire: the mock and MuJoCo."""
