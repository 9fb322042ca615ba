"""One recording of a moving arm calibrates its whole cell: lenses, rig, timing, base, target and the arm itself."""

from armsight.calibrate.cell.calibrate import CellOptions, calibrate_cell
from armsight.calibrate.cell.knowledge import ArmTolerance, CellPriors
from armsight.calibrate.cell.result import CellResult

__all__ = ["ArmTolerance", "CellOptions", "CellPriors", "CellResult", "calibrate_cell"]
