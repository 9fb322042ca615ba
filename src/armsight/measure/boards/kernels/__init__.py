"""Compiled code of the boards: subpixel corners and dots, templates, drawing."""
