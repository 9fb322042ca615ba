"""Pachidis et al. 2005: lit areas of a complex image, and places from a camera with four mirrors."""
