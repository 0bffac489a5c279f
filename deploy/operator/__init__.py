"""Who asks for what, and what they see of a run: keys, remote, console, viewer."""
