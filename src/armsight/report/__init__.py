"""Tables, plots and pages; what is here is loaded when it is first used."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armsight.fields import loaded_names

if TYPE_CHECKING:
    from armsight.report.calibration import calibration_report as calibration_report
    from armsight.report.measure import measure_report as measure_report
    from armsight.report.run import MeasureRun as MeasureRun
    from armsight.report.run import Sample as Sample

_PLACES = {
    "calibration_report": "calibration",
    "measure_report": "measure",
    "MeasureRun": "run",
    "Sample": "run",
}

if not TYPE_CHECKING:  # type checkers know the names above, and refuse all others
    __all__ = sorted(_PLACES)
    __getattr__ = loaded_names(__name__, _PLACES)
