"""What the commands of `armsight history` are told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import HISTORY_PLACE, OUT

ONCE_IN_YEARS = 100.0
"""Cell-years in which one false alarm is accepted, unless another rate is given."""

APlace: TypeAlias = Annotated[str | None, Doc(HISTORY_PLACE), Flag("--history", metavar="FILE_OR_URL")]
Since: TypeAlias = Annotated[
    str | None, Doc("Runs from this day or moment on (2026-11-26, 2026-11-26T14:00)."), Flag(metavar="WHEN")
]
Until: TypeAlias = Annotated[str | None, Doc("Runs before this day or moment."), Flag(metavar="WHEN")]
OfCommand: TypeAlias = Annotated[
    str | None, Doc("Runs of this command alone, such as verify, calibrate or 'calibrate arm'.")
]


@dataclass(frozen=True, kw_only=True)
class AddJob:
    """A result of an earlier run."""

    result: Annotated[
        Path,
        Doc("verify.json, what --json printed, a YAML file of a calibration, or a run that could not be filed."),
        Flag(positional=True, metavar="RESULT"),
    ]
    cell: Annotated[str | None, Doc("The cell that it is of."), Flag(metavar="NAME")] = None
    arm_file: Annotated[Path | None, Doc("With the JSON of calibrate arm: the arm.yaml that it wrote.")] = None
    created: Annotated[
        str | None, Doc("When the result was made. [default: as its file says]"), Flag(metavar="WHEN")
    ] = None
    history: APlace = None


@dataclass(frozen=True, kw_only=True)
class ListJob:
    """Runs, the newest first."""

    cell: Annotated[str | None, Doc("Runs of this cell alone."), Flag(metavar="NAME")] = None
    command: OfCommand = None
    since: Since = None
    until: Until = None
    most: Annotated[int, Doc("List so many at the most."), Bounds(least=1, most=100_000)] = 50
    history: APlace = None


@dataclass(frozen=True, kw_only=True)
class ShowJob:
    """One run."""

    run: Annotated[
        int, Doc("The run's number, as list shows it."), Bounds(least=1), Flag(positional=True, metavar="ID")
    ]
    history: APlace = None


@dataclass(frozen=True, kw_only=True)
class CompareRunsJob:
    """Two runs."""

    a: Annotated[int, Doc("The number of a run."), Bounds(least=1), Flag(positional=True, metavar="A")]
    b: Annotated[int, Doc("The number of another."), Bounds(least=1), Flag(positional=True, metavar="B")]
    history: APlace = None


@dataclass(frozen=True, kw_only=True)
class ExportRunsJob:
    """Every number of every run as a table."""

    out: Annotated[Path, Doc("Table to write: .csv, .parquet or .jsonl."), OUT]
    cell: Annotated[str | None, Doc("Runs of this cell alone."), Flag(metavar="NAME")] = None
    command: OfCommand = None
    since: Since = None
    until: Until = None
    history: APlace = None


@dataclass(frozen=True, kw_only=True)
class TrendJob:
    """The runs of a cell, and which figures to judge."""

    cell: Annotated[str, Doc("The cell."), Flag(metavar="NAME")]
    out: Annotated[Path, Doc("Folder for report.html and trend.json."), Flag("-o --out", metavar="FOLDER")]
    figure: Annotated[
        list[str] | None,
        Doc(
            "joint-zeros, hand-eye, rig, tool-tip, world, all; one parameter (joint2.theta_rad); or a number of the "
            "results (residual_rms_m). May be repeated. [default: the five groups]"
        ),
    ] = None
    command: OfCommand = None
    since: Since = None
    until: Until = None
    false_alarms: Annotated[
        float,
        Doc("Accept one false alarm in so many cell-years, over all figures together."),
        Bounds(least=0.01, most=1e9),
        Flag(metavar="CELL_YEARS"),
    ] = ONCE_IN_YEARS
    history: APlace = None
