"""Simulated cells and scenarios by name, and their frames and truth as files."""
