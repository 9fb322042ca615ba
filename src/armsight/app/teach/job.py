"""What is taught, and where it goes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from armsight.app.requests.motion import TeachJob
from armsight.app.schemas.servo import ServoOutput
from armsight.app.schemas.teach import TeachOutput
from armsight.control.teach import PathRecorder
from armsight.store import write_poses
from armsight.store.path_file import write_path

PATH, TARGETS, SUMMARY = "path.csv", "targets.csv", "teach.json"

Begun = Callable[[PathRecorder], None]
"""Is given the recorder once it is there, so that a key or a page may start, pause, undo and tag."""


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
    done.write(job.out / SUMMARY)
    return done
