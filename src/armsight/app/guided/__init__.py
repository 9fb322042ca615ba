"""Calibrations a person is led through: what to do next, what there is so far, how sure it is, and the verdict."""
