"""Sweeps of an unknown arm in, or the arm itself moved; its geometry out."""
