"""Motion clips: format, import, authoring, metrics."""
