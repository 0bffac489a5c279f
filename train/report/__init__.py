"""What a run tells afterwards: report.html, from the files in the run's folder."""
