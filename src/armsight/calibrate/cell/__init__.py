"""One recording of a moving arm calibrates its whole cell: lenses, rig, timing, base, target and the arm itself."""

from armsight.calibrate.cell.calibrate import CellOptions as CellOptions
from armsight.calibrate.cell.calibrate import calibrate_cell as calibrate_cell
from armsight.calibrate.cell.knowledge import ArmTolerance as ArmTolerance
from armsight.calibrate.cell.knowledge import CellPriors as CellPriors
from armsight.calibrate.cell.result import CellResult as CellResult
