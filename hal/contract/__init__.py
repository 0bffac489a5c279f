"""What every backend answers to."""
