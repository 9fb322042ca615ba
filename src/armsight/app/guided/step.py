"""What every guided calibration offers a screen."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Protocol, runtime_checkable

from armsight.app.live.station import MeasurementProcess
from armsight.records import Progress
from armsight.records.result_parts import Verdict


class Next(StrEnum):
    """What the person should do next; screens have the words."""

    SHOW_BOARD = "show_board"
    BOARD_TWICE = "board_twice"
    SHOW_LIGHTS = "show_lights"
    TURN_LIGHTS = "turn_lights"
    NEEDS_LENS = "needs_lens"
    NEEDS_BASELINE = "needs_baseline"
    NEEDS_TARGET = "needs_target"
    JOIN = "join"
    TO_CELL = "to_cell"
    TILT = "tilt"
    NEARER = "nearer"
    TURN_TARGET = "turn_target"
    MOVE_ROBOT = "move_robot"
    TURN_HAND = "turn_hand"
    RECORD = "record"
    RECORD_CELL = "record_cell"
    LIGHTS_BACK = "lights_back"
    MOVE_JOINT = "move_joint"
    TO_PLACE = "to_place"
    GO_ON = "go_on"
    END_RECORDING = "end_recording"
    BRING_LOG = "bring_log"
    MORE = "more"
    RUN = "run"
    NOT_POSSIBLE = "not_possible"


@dataclass(frozen=True, slots=True, kw_only=True)
class Hint:
    """What to do next, where in the picture (side, column and row of a 3x3 grid), and why nothing can be done.

    axis: of the hand, x, y or z, about which it should be turned, or a joint's name; share: how much of that there is,
    0 to 1.
    """

    what: Next
    side: str = ""
    cell: tuple[int, int] | None = None
    why: str = ""
    axis: str = ""
    share: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One thing taken: its name, and what a table says of it; used: False where it was left out, and why."""

    name: str
    detail: str
    used: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class StepResult:
    """What a calibration came to. verdict: the result's own; rows: names and values for a table.

    file: what was written; report: beside it, None where there is none. lists: more to read, title and lines. use:
    under which keys of the cell which files stand, None for none, where it is not the one file of the step.
    """

    verdict: Verdict
    rows: tuple[tuple[str, str], ...]
    file: Path
    report: Path | None = None
    lists: tuple[tuple[str, tuple[str, ...]], ...] = ()
    use: tuple[tuple[str, Path | None], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A number that should fall, or settle, as samples are added; name and unit as a person reads them."""

    name: str
    value: float
    unit: str


@runtime_checkable
class Charted(Protocol):
    """A step that tells numbers for a plot against the number of samples."""

    def figures(self) -> tuple[Figure, ...]:
        """Return the numbers of now; empty where there are none yet."""
        ...


class Guided(Protocol):
    """A calibration in steps. Methods may take a second and be called from a thread; all raise ArmsightError."""

    @property
    def name(self) -> str:
        """Key of the step, such as stereo."""
        ...

    @property
    def samples(self) -> tuple[Sample, ...]:
        """What was accepted so far."""
        ...

    def hint(self) -> Hint:
        """Return what to do next."""
        ...

    def coverage(self) -> dict[str, tuple[int, ...]]:
        """Return per camera how many samples lie in each of nine cells of the picture, row by row; empty: none."""
        ...

    def spread(self) -> tuple[tuple[str, str], ...]:
        """Return the live standard deviations as names and values, as far as they can be told."""
        ...

    def accept(self, station: MeasurementProcess) -> Sample:
        """Take what is seen now. Raises what hinders it, in words."""
        ...

    def drop(self, index: int) -> None:
        """Forget a sample."""
        ...

    def run(self, progress: Progress) -> StepResult:
        """Calibrate and write the file."""
        ...
