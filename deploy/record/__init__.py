"""What a run leaves behind: recording, log, its replay, film, report."""
