"""Device-side emulators: the other end of each wire, moved by one simulated robot."""
