"""Paths of the tool's tip: sampled anew, rounded, moved, tilted, joined, and checked for an arm before any motion."""

from armsight.control.paths.along import corners, joined, offset_along_tool, poses_at, resampled, reversed_path, tilted
from armsight.control.paths.check import PathCheck, PathIssue, PathTrouble, check_path
from armsight.control.paths.exports import krl, python_module, rapid, urscript
from armsight.control.paths.outliers import PathOutlier, outliers, without_rows
from armsight.control.paths.program import Program, ProgramMove, program_moves, with_approach
from armsight.control.paths.smoothing import filleted, moved_by, smoothed
