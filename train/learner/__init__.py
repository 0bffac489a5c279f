"""PPO with one value head per reward term."""
