"""Simulated cells and scenarios by name, and their frames and truth as files."""

MOST_FRAMES = 100_000
"""Of a simulation: an hour at 30 frames a second. Its tables, in memory, are 1 GB then."""
