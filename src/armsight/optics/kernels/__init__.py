"""Compiled optics: one camera, rays of two, and where they meet."""
