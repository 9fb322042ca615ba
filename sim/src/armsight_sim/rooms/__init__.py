"""Rooms: what stands behind the target, as geometry in the world."""
