"""armsight sees where a robot arm really is."""

from importlib.metadata import version

__version__ = version("armsight")
