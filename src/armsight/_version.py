"""The version of armsight and of armsight-sim: both are built with it."""

__version__ = "0.1.0"
