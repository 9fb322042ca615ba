"""What `armsight design` tells."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import MEANING, Verdict

MOSTLY = 0.95
"""Share of the volume from which on it counts as measured."""


@output
class Spread(Output):
    """Expected deviations over the measured cells of a volume: RMS of the distance or angle from the truth.

    worst_at: where the worst is, in the volume's frame.
    """

    median: Annotated[float, Doc("Median over the cells, m or rad.")]
    p95: Annotated[float, Doc("95 % of the cells are no worse, m or rad.")]
    worst: Annotated[float, Doc("The worst cell, m or rad.")]
    worst_at_m: Annotated[tuple[float, float, float], Doc("Where that is, in the volume's frame, m.")]


@output
class PointDeviation(Output):
    """Expected deviations of one light, or of a board's corners, placed by itself."""

    name: Annotated[str, Doc("The light's name; of a board: corners.")]
    median_m: Annotated[float, Doc("Median over the cells in which it is seen, m.")]
    p95_m: Annotated[float, Doc("95 % of them are no worse, m.")]
    worst_m: Annotated[float, Doc("The worst, m.")]


@output
class DesignPart(Output):
    """What a part of the deviation comes to, RMS over the measured cells."""

    name: Annotated[str, Doc("Noise of one frame, calibration of the rig, measures of the target, poses of the arm.")]
    position_m: Annotated[float, Doc("Of the position, m.")]
    orientation_rad: Annotated[float | None, Doc("Of the orientation, rad; null where none is measured.")]
    share: Annotated[float, Doc("Its share of the position's variance, 0 to 1.")]


@output
class NotMeasured(Output):
    """Cells in which nothing is measured, or no orientation, by the reason."""

    why: Annotated[str, Doc("The reason.")]
    share: Annotated[float, Doc("Share of the volume, 0 to 1.")]
    position: Annotated[bool, Doc("Whether a position is measured there all the same.")]


@output
class DesignChange(Output):
    """What a change of the plan leads to, worked out anew."""

    change: Annotated[str, Doc("What is changed.")]
    position_m: Annotated[float | None, Doc("Deviation of the position, 95 % of the measured cells, m; null: refused.")]
    orientation_rad: Annotated[float | None, Doc("The same of the orientation, rad; null where none is measured.")]
    measured: Annotated[float, Doc("Share of the volume that is measured, 0 to 1.")]
    sufficient: Annotated[bool | None, Doc("Whether the wanted deviation is reached; null where none is wanted.")]
    why: Annotated[str | None, Doc("Why it cannot be.")] = None


@output
class DesignCalibration(Output):
    """How well the rig will be known."""

    views: Annotated[int | None, Doc("Pictures of the board; null where the file's own calibration is taken.")]
    baseline_std_m: Annotated[float | None, Doc("Standard deviation of the baseline, m; null of no pair.")]
    focal_std_px: Annotated[float, Doc("Of the first camera's focal length, px.")]
    turn_std_rad: Annotated[float, Doc("Of the other cameras' direction against the first one's, worst axis, rad.")]


@output
class SimulatedPlace(Output):
    """One place of the simulation."""

    xyz_m: Annotated[tuple[float, float, float], Doc("Where, in the volume's frame, m.")]
    expected_m: Annotated[float, Doc("Deviation of the position as foretold, of a single frame, m.")]
    position_m: Annotated[float, Doc("As simulated: RMS over the runs, m.")]
    expected_rad: Annotated[float | None, Doc("Of the orientation as foretold, rad; null where none is measured.")]
    orientation_rad: Annotated[float | None, Doc("As simulated, rad.")]


@output
class DesignSimulation(Output):
    """Simulated calibrations and measurements beside what was foretold.

    The simulated world projects by itself: it shares no code with the forecast nor with what measures.
    """

    n_runs: Annotated[int, Doc("Calibrations simulated, each with measurements at all places.")]
    n_failed: Annotated[int, Doc("Of these refused.")]
    n_poses: Annotated[int, Doc("Poses measured.")]
    n_lost: Annotated[int, Doc("Places at which a calibrated rig gave no pose.")]
    ratio_position: Annotated[
        float, Doc("Simulated deviation over the one foretold, of the position, RMS over places.")
    ]
    ratio_orientation: Annotated[float | None, Doc("The same of the orientation; null where none is measured.")]
    ratio_std: Annotated[float, Doc("Standard deviation of these ratios for so few runs.")]
    agrees: Annotated[bool, Doc("Whether both are within 15 % of one, or as near as so few runs can tell.")]
    places: Annotated[tuple[SimulatedPlace, ...], Doc("By place.")]


@output
class DesignOutput(Output):
    """armsight design."""

    baseline_m: Annotated[float | None, Doc("Distance of the cameras, m; null of other rigs than pairs.")]
    focal_px: Annotated[float, Doc("Focal length of the first camera, px.")]
    frame: Annotated[str, Doc("Frame of the volume: rig, world or base.")]
    deviation_in: Annotated[
        str, Doc("What the deviations are in: rig (the left camera's axes), volume (aligned to it), or base.")
    ]
    n_cells: Annotated[int, Doc("Cells that were looked at.")]
    measured: Annotated[float, Doc("Share of the volume in which a position is measured, 0 to 1.")]
    whole: Annotated[float, Doc("Share in which an orientation is, too.")]
    position: Annotated[Spread, Doc("Deviation of the position.")]
    orientation: Annotated[Spread | None, Doc("Deviation of the orientation; null where none is measured.")]
    aligned: Annotated[
        Spread | None,
        Doc("Deviation of the position once the volume is aligned as a whole; null with an arm, and of few cells."),
    ]
    points: Annotated[tuple[PointDeviation, ...], Doc("Of each light by itself, as points.csv has them.")]
    parts: Annotated[tuple[DesignPart, ...], Doc("What it is made of, the largest first.")]
    not_measured: Annotated[tuple[NotMeasured, ...], Doc("Where there is no pose, or no orientation.")]
    calibration: Annotated[DesignCalibration, Doc("How well the rig will be known.")]
    wanted_m: Annotated[float | None, Doc("The wanted deviation, m; null where none was asked for.")]
    reached: Annotated[
        bool | None, Doc("Whether at least 95 % of the volume is measured as well as wanted; null where none is.")
    ]
    changes: Annotated[tuple[DesignChange, ...], Doc("What changes lead to; what suffices first, the cheapest first.")]
    best_m: Annotated[float | None, Doc("The least deviation that was reached by all that was tried, m.")]
    simulation: Annotated[DesignSimulation | None, Doc("With --simulate; null without.")]
    verdict: Annotated[str, Doc("The answer in a sentence.")]
    advice: Annotated[tuple[str, ...], Doc("What to do, and what to know.")]
    assumptions: Annotated[tuple[str, ...], Doc("What was taken for granted.")]
    report: Annotated[str, Doc("The report.")]
    seen: Annotated[
        dict[str, float] | None,
        Doc("Of each camera the share of the lights that it sees over the volume, 0 to 1; left out of plain pairs."),
    ] = None

    @figure(MEANING, optional=True)
    def verdict_(self) -> Verdict:
        if self.simulation is not None and not self.simulation.agrees:
            level, headline, todo = (
                "bad",
                "Not confirmed",
                "Do not rely on these figures: the simulation says otherwise.",
            )
        elif self.reached is None:
            level, headline = "good" if self.measured > MOSTLY else "care", "Forecast"
            todo = "Give --wanted-mm to be told what reaches an accuracy."
        elif self.reached:
            level, headline, todo = "good", "Reached", "Build it as planned."
        else:
            first = next((one for one in self.changes if one.sufficient), None)
            level, headline = "care" if first else "bad", "Not reached"
            todo = f"Change the plan: {first.change}." if first else "Come closer, or want less."
        return Verdict(level=level, headline=headline, reasons=[self.verdict], next=[todo])
