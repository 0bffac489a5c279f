"""Rules between actor and robot. Only the guard makes the commands that a backend is given."""
