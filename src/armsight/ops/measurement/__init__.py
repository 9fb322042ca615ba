"""Frames in, poses with their uncertainty out: the run, its files and its report."""
