"""Compiled kernels of the calibrations."""
