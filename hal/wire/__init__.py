"""Backends that drive real wires: a process that owns the wire, and the side of it that the control loop sees."""
