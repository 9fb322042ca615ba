"""Compiled parts of the calibration from boards."""
