"""The actor contract: spec, metadata, observations, inference."""
