"""Frames of both cameras -> the pose of the target, with covariance, or the reason why there is none."""
