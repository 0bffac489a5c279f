"""Training of one tracking policy per clip."""
