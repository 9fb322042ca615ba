"""The version of armsight and of its other distributions: all are built with it."""

__version__ = "0.1.0"
