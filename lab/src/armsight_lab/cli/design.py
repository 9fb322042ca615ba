"""armsight design: what a rig will measure before it is bought."""

from __future__ import annotations

from typing import TYPE_CHECKING

from armsight.cli.command import declared
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure
from armsight.units import DEG, MM
from armsight_lab.design.request import ARM, CALIBRATION, RIG, DesignJob

if TYPE_CHECKING:
    from armsight_lab.design.records import DesignOutput, Spread

DESIGNED = ("design.json", "map.csv", "report.html", "runs")


@declared(keeps=DESIGNED, panels=(RIG, CALIBRATION, ARM), judged=True)
def design(face: CommandUI, job: DesignJob) -> None:
    """Tell what a planned rig will measure over a volume, what the deviations come from, and what to change.

    Writes design.json, map.csv and report.html with a coloured map.
    """
    from armsight_lab.design.run import run_design

    done = run_design(job, face.progress("planning"))
    design_tables(face, done)
    face.say(f"Results: {job.out}; open {done.report}")
    face.result(done)


def design_tables(face: CommandUI, done: DesignOutput) -> None:
    """Print what was worked out."""
    face.say(done.verdict)
    rows = [["position, mm", *_spread(done.position, MM)]]
    if done.orientation is not None:
        rows.append(["orientation, deg", *_spread(done.orientation, DEG)])
    if done.aligned is not None and done.deviation_in == "rig":
        rows.append(["position once aligned, mm", *_spread(done.aligned, MM)])
    face.table(
        f"Deviation over {100.0 * done.measured:.0f} % of the volume",
        ["", "median", "95 %", "worst", "worst at, m"],
        rows,
    )
    parts = [
        [one.name, figure(one.position_m / MM), _degrees(one.orientation_rad), f"{100.0 * one.share:.0f} %"]
        for one in done.parts
    ]
    face.table("What it is made of, RMS", ["", "mm", "deg", "of the variance"], parts)
    changes = [
        [
            one.change if one.why is None else f"{one.change}: {one.why}",
            figure(None if one.position_m is None else one.position_m / MM),
            _degrees(one.orientation_rad),
            f"{100.0 * one.measured:.0f} %",
            "" if one.sufficient is None else "yes" if one.sufficient else "no",
        ]
        for one in done.changes
    ]
    face.table("What changes lead to, 95 %", ["", "mm", "deg", "measured", "suffices"], changes)
    if done.simulation is not None:
        one = done.simulation
        turn = "" if one.ratio_orientation is None else f", orientation {one.ratio_orientation:.2f}"
        face.say(
            f"Simulated {one.n_runs} times: position {one.ratio_position:.2f}{turn} of what is foretold, +- "
            f"{one.ratio_std:.2f}; {one.n_failed} calibrations refused, {one.n_lost} poses lost"
        )
    for text in done.advice:
        face.say(f"- {text}")
    for text in done.assumptions:
        face.say(f"Taken for granted: {text}")


def _spread(one: Spread, unit: float) -> list[str]:
    at = ", ".join(f"{value:.3g}" for value in one.worst_at_m)
    return [*(figure(value / unit) for value in (one.median, one.p95, one.worst)), at]


def _degrees(value: float | None) -> str:
    return figure(None if value is None else value / DEG)
