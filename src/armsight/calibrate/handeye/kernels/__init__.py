"""Compiled core of the hand-eye fit."""
