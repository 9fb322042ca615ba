"""Frames -> spots -> matched spots -> points -> poses."""
