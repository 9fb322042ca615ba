"""Compiled code of the pose: correspondence, fit, covariance."""
