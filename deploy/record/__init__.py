"""What remains of a run: recording, log, replay, film, report."""
