"""Serial IMUs: their frames, and a reader that knows the age of every sample."""
