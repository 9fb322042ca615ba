"""Which page's verdict is a result's: the terminal, `verdict_` in JSON and `--check` tell what the report does."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

    from armsight.records.verdict import Verdict

Result = TypeVar("Result")


def with_verdict(done: Result, of: Callable[[Any], Verdict | None]) -> Result:
    """Return a result with its verdict."""
    return replace(done, verdict_=of(done))  # type: ignore[type-var]  # all results are dataclasses


def of_verification(done: Any) -> Verdict | None:
    """Return the verdict of `verify` in each of its ways; None of a plan."""
    from armsight.report.repeats_report import repeats_verdict
    from armsight.report.verdicts import live_verdict, mastering_verdict, verify_verdict
    from armsight.verify.results import MasteringOutput, VerifyLiveOutput, VerifyOutput

    if isinstance(done, VerifyOutput):
        return (repeats_verdict if done.after is None else verify_verdict)(done).told
    if isinstance(done, MasteringOutput):
        return mastering_verdict(done).told
    return live_verdict(done).told if isinstance(done, VerifyLiveOutput) else None


def of_measurement(run: Any) -> Verdict | None:
    """Return the verdict of what was measured."""
    from armsight.report.measure import measure_verdict

    return measure_verdict(run).told


def of_identification(result: Any, sweeps: Any, rig: Any) -> Verdict | None:
    """Return the verdict of an arm that was identified."""
    from armsight.report.identify_report import identify_verdict

    return identify_verdict(result, sweeps, rig).told


def of_camera(done: Any) -> Verdict | None:
    """Return the verdict of a camera's calibration; None of its noise alone."""
    from armsight.app.calibrate.reports import camera_run
    from armsight.calibrate.cameras import CameraCalibration
    from armsight.report.calibration import calibration_verdict

    return calibration_verdict(camera_run(done, "")).told if isinstance(done, CameraCalibration) else None


def of_stereo(done: Any) -> Verdict | None:
    """Return the verdict of a pair's calibration."""
    from armsight.app.calibrate.reports import RigData, stereo_run
    from armsight.report.calibration import calibration_verdict

    return calibration_verdict(stereo_run(done, RigData(board=""))).told


def of_handeye(done: Any) -> Verdict | None:
    """Return the verdict of a hand-eye calibration."""
    from armsight.report.handeye_report import handeye_verdict

    return handeye_verdict(done).told


def of_arm(done: Any) -> Verdict | None:
    """Return the verdict of an arm's calibration."""
    from armsight.report.arm_report import arm_verdict

    return arm_verdict(done).told


def of_cell(done: Any) -> Verdict | None:
    """Return the verdict of a cell's calibration."""
    from armsight.report.cell_report import cell_verdict

    return cell_verdict(done).told


def of_design(done: Any) -> Verdict | None:
    """Return the verdict of a planned rig."""
    from armsight.report.design_report import design_verdict

    return design_verdict(done).told


def of_comparison(done: Any) -> Verdict | None:
    """Return the verdict of two results held beside each other."""
    from armsight.report.compare_report import compare_verdict

    return compare_verdict(done.agree, done.verdict).told


def of_trend(done: Any) -> Verdict | None:
    """Return the verdict of a cell's history."""
    from armsight.report.history_report import trend_verdict

    few = all(one.state == "few" for one in done.figures)
    return trend_verdict(done.changed, few, [one.to_do for one in done.figures], done.verdict).told
