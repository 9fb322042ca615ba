"""Observations -> parameters: cameras, mirror rigs, lit targets, hand-eye, tool tip, arms."""
