"""Compiled code of the measuring path."""
