"""Tables, plots, HTML."""

from armsight.report.calibration import calibration_report
from armsight.report.measure import measure_report
from armsight.report.run import CalibrationRun, CameraFit, MeasureRun, Parameter, Sample

__all__ = [
    "CalibrationRun",
    "CameraFit",
    "MeasureRun",
    "Parameter",
    "Sample",
    "calibration_report",
    "measure_report",
]
