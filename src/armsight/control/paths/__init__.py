"""Paths of the tool's tip: sampled anew, rounded, and checked for an arm before any motion."""

from armsight.control.paths.along import corners, poses_at, resampled
from armsight.control.paths.check import PathCheck, PathIssue, PathTrouble, check_path
from armsight.control.paths.fillets import filleted

__all__ = ["PathCheck", "PathIssue", "PathTrouble", "check_path", "corners", "filleted", "poses_at", "resampled"]
