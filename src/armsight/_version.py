"""The version of armsight, of armsight-sim and of armsight-lab: all are built with it."""

__version__ = "0.1.0"
