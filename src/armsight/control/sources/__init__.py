"""Who asks for motion: one at a time, all through the guard."""

from armsight.control.sources.client import ClientSource
from armsight.control.sources.goal import GoalSource
from armsight.control.sources.jog import JogFrame, JogSource

__all__ = ["ClientSource", "GoalSource", "JogFrame", "JogSource"]
