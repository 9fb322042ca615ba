"""A path run with the tip of a tool: planned and checked first, then played as set points, and watched by cameras."""

from armsight.control.play.path_source import PathSource, PlayProgress
from armsight.control.play.plan import PathPlan, PlaySettings, plan_path
from armsight.control.play.play_watch import CameraPlacement, PlayWatch, WatchFigures
from armsight.control.play.shape import Weave, WeaveKind
