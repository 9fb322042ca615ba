"""Measured against expected: files in, figures, table and report out."""
