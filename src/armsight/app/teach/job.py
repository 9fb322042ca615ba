"""What is taught, and where it goes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.app.schemas.servo import ServoOutput
from armsight.app.schemas.teach import TeachOutput
from armsight.control.teach import PathRecorder
from armsight.errors import UsageError
from armsight.store import write_poses
from armsight.store.atomic import write_json
from armsight.store.handeye_file import read_tip
from armsight.store.path_file import write_path

PATH, TARGETS, SUMMARY = "path.csv", "targets.csv", "teach.json"

Begun = Callable[[PathRecorder], None]
"""Is given the recorder once it is there, so that a key or a page may start, pause, undo and tag."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeachJob:
    """tip: tip.yaml of the point that is led along, in target axes; None: the target's origin.

    every: frames per vector. mean: a vector is the mean of its frames. path_speed_m_s: written into the path; None:
    left open. wait: record nothing until the recorder is started; else from the first frame on.
    """

    out: Path
    tip: Path | None = None
    every: int = 1
    mean: bool = False
    path_speed_m_s: float | None = None
    wait: bool = False

    def __post_init__(self) -> None:
        if self.path_speed_m_s is not None and not (np.isfinite(self.path_speed_m_s) and self.path_speed_m_s > 0.0):
            raise UsageError(
                f"--path-speed {self.path_speed_m_s:g} is no speed",
                consequence="Nothing is taught",
                cure="Give m/s, more than zero",
            )

    def T_target_tip(self) -> RigidTransform:
        """Return the tip in target axes. Raises BadFile."""
        if self.tip is None:
            return RigidTransform.identity()
        return RigidTransform.from_translation(read_tip(self.tip).tip_m)


def save(job: TeachJob, recorder: PathRecorder) -> None:
    """Write path.csv and targets.csv. Raises NotEnoughData for less than two poses."""
    speed = np.nan if job.path_speed_m_s is None else job.path_speed_m_s
    path = recorder.path(speed_m_s=speed)
    job.out.mkdir(parents=True, exist_ok=True)
    write_path(job.out / PATH, path)
    write_poses(job.out / TARGETS, recorder.targets())


def saved(job: TeachJob, recorder: PathRecorder, stopped_by: str, servo: ServoOutput | None = None) -> TeachOutput:
    """Write the files and return the figures. Raises NotEnoughData for less than two poses."""
    save(job, recorder)
    path, counts = recorder.path(), recorder.counts
    done = TeachOutput(
        state=None if servo is None else servo.state,
        n_cycles=0 if servo is None else servo.n_cycles,
        late=0 if servo is None else servo.late,
        stopped_by=stopped_by,
        path=str(job.out / PATH),
        parent=path.parent,
        n_rows=len(path),
        n_stretches=recorder.stretches,
        length_m=float(path.length_m[-1]),
        n_ok=counts.ok,
        n_doubtful=counts.doubtful,
        n_position_only=counts.position_only,
        n_lost=counts.lost,
        n_unplaced=counts.unplaced,
        servo=servo,
    )
    write_json(job.out / SUMMARY, done.to_dict())
    return done
