"""The tracking environment: terms, curricula and the step that joins them."""
