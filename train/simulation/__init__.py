"""Batched physics: the interface and the implementation on CPU cores."""
