"""Who asks, and what is shown to whom asks: keys, remote, gamepad, console, window."""
