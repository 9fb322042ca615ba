"""Compiled: where something bright may be a light, before any model is fitted."""
