"""Compiled parts of the calibration of a lit target."""
