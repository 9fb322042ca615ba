"""Observations -> parameters: cameras, rigs, and what they were fitted to."""
