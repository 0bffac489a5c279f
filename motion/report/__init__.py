"""What a processed motion tells of itself: report.html and report.json."""
