"""Readers of other people's motion files; each gives a Clip."""
