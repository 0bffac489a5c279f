"""Pictures: renderers, video, viewer."""
