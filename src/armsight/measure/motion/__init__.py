"""A target in motion: pose and velocity from single views, each at its own time, causal and smoothed."""
