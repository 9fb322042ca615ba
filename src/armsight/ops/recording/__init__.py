"""Frames into recordings, recordings into plain files."""
