"""The loop of a run: its tick, its states, what asks for the next one, its times."""
