"""What the computer on board needs, and what checks it."""
