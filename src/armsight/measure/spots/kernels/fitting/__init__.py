"""Compiled: models of light fitted to the pixels, the choice between them, and covariances."""
