"""What a robot stands in and what drives it, once for simulation, emulators and training."""
