"""Compiled filter of a moving target."""
