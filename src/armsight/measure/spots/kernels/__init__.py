"""Compiled parts of the search for spots: scan, components, fits, and the choice between models."""
