"""Paths of the tool's tip: sampled anew, rounded, moved, tilted, joined, and checked for an arm before any motion."""

from armsight.control.paths.along import corners, poses_at, resampled
from armsight.control.paths.check import PathCheck, PathIssue, PathTrouble, check_path
from armsight.control.paths.fillets import filleted
from armsight.control.paths.outliers import PathOutlier, outliers, without_rows
from armsight.control.paths.smoothing import moved_by, smoothed
from armsight.control.paths.tools import joined, offset_along_tool, reversed_path, tilted

__all__ = [
    "PathCheck",
    "PathIssue",
    "PathOutlier",
    "PathTrouble",
    "check_path",
    "corners",
    "filleted",
    "joined",
    "moved_by",
    "offset_along_tool",
    "outliers",
    "poses_at",
    "resampled",
    "reversed_path",
    "smoothed",
    "tilted",
    "without_rows",
]
