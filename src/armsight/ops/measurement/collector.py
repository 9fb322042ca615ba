"""What a run's report needs, collected while it goes, in bounded memory but for the poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.file_names import MEASURE, REPORT
from armsight.measure.consistency.findings import Consistency
from armsight.measure.poses.pipeline import Measured, Setup
from armsight.measure.results import CameraPart, MeasureResult
from armsight.measure.track import PackedPoses
from armsight.ops.measurement.outputs import Outputs
from armsight.optics import ZoomState
from armsight.records import Frame, PoseStatus, Progress, TargetPose
from armsight.report.measure import measure_report
from armsight.report.residuals import distance_rms
from armsight.report.run import MeasureRun, Sample
from armsight.store import World, write_text
from armsight.store.atomic import write_json

Zoomed = dict[str, ZoomState]
"""The state of each camera that zooms, by left and right."""

MAX_RESIDUALS = 20_000
"""Residual vectors kept per camera: a cloud of more is no clearer; beyond it every second one goes."""

MAX_PROBLEMS = 2
"""Frames shown for what was wrong with them, beside one that was measured well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class About:
    """What a report says beside the measurement: more lines on its inputs, and the true pose per pair where known.

    assumed_fps: frames a second that were assumed, where nothing tells the frames' times. stills: whether the frames
    are single shots, which have no track and no seconds. recordings: files that the frames are in. zoomed: the cameras
    that zoom.
    """

    title: str = "Measurement"
    facts: Sequence[tuple[str, str]] = ()
    assumptions: Sequence[str] = ()
    truth: Sequence[RigidTransform] | None = None
    assumed_fps: float | None = None
    stills: bool = False
    recordings: Sequence[str] = ()
    zoomed: Zoomed = field(default_factory=dict)


class Collector:
    """Sees every step of a run and writes report.html at its end."""

    def __init__(self, setup: Setup, world: World | None = None) -> None:
        self._setup, self._world = setup, world
        self._poses = PackedPoses()
        self._residuals: dict[str, list[Array]] = {name: [] for name in setup.rig.names}
        self._pictures: Counter[str] = Counter()
        self._showing: Counter[str] = Counter()
        self._n_residuals = 0
        self._every = 1
        self._samples: dict[str, tuple[Sample, ...]] = {}

    @property
    def poses(self) -> PackedPoses:
        """The poses so far, one per pair."""
        return self._poses

    def add(self, frames: Sequence[Frame | None], measured: Measured, pose: TargetPose) -> None:
        """Take the frames of a moment, what was measured in them, and its pose in the parent frame."""
        number = len(self._poses)
        self._add(number, measured, pose)
        for name, frame in zip(self._setup.rig.names, frames, strict=True):
            self._pictures[name] += frame is not None
        self._keep_sample(number, frames, measured, pose)

    def again(self, moments: Iterable[Measured], outputs: Outputs) -> None:
        """Take all moments as they are solved anew, and write them: the images shown stay."""
        self._poses = PackedPoses()
        self._showing.clear()
        self._every, self._n_residuals = 1, 0
        for rows in self._residuals.values():
            rows.clear()
        for number, measured in enumerate(moments):
            self._add(number, measured, outputs.add(measured))

    def by_camera(self, consistency: Consistency) -> dict[str, CameraPart]:
        """Return what each camera had of the run."""
        why = {name: one.words for one in consistency.left_out for name in one.names}
        return {
            name: CameraPart(
                n_frames=self._pictures[name],
                n_used=self._showing[name],
                rms_px=distance_rms([part[:, 1:] for part in rows]) if rows else None,
                left_out=why.get(name),
            )
            for name, rows in self._residuals.items()
        }

    def _add(self, number: int, measured: Measured, pose: TargetPose) -> None:
        self._poses.append(pose)
        if number % self._every == 0:
            self._keep_residuals(number, measured)
        for name, spots in zip(self._setup.rig.names, measured.spots, strict=True):
            self._showing[name] += len(spots) > 0

    def truth(self, about: About) -> Sequence[RigidTransform] | None:
        """Return the true poses of the pairs so far, where they are known."""
        return None if about.truth is None else about.truth[: len(self._poses)]

    def write(self, folder: Path, summary: MeasureResult, about: About, progress: Progress) -> None:
        """Write the report of the moments so far, and their figures."""
        progress.update(0, 0, "writing the report")
        run = MeasureRun(
            poses=self._poses,
            rig=self._setup.rig,
            target=self._setup.target,
            residuals={side: np.vstack(rows) for side, rows in self._residuals.items() if rows},
            n_aside=summary.n_aside or 0,
            samples=[sample for pair in self._samples.values() for sample in pair],
            timed=about.assumed_fps is None and not about.stills,
            stills=about.stills,
            truth=self.truth(about),
            median_ms=summary.ms_per_frame.median,
            p99_ms=summary.ms_per_frame.p99,
            parent="rig" if self._world is None else self._world.parent,
            T_parent_rig=None if self._world is None else self._world.T_parent_rig,
            title=about.title,
            facts=about.facts,
            recordings=about.recordings,
            assumptions=about.assumptions,
            consistency=summary.consistency,
            by_camera=summary.by_camera or {},
            verdict=summary.verdict_,
        )
        write_text(folder / REPORT, measure_report(run))
        write_json(folder / MEASURE, summary.to_dict())

    def _keep_residuals(self, number: int, measured: Measured) -> None:
        most = 0
        for s, rows in enumerate(self._residuals.values()):
            vectors = measured.judged_px(s)
            if len(vectors):
                rows.append(np.column_stack([np.full(len(vectors), float(number)), -vectors]))
            most = max(most, len(vectors))
        self._n_residuals += most
        if self._n_residuals > MAX_RESIDUALS:
            self._every *= 2
            for side, rows in self._residuals.items():
                self._residuals[side] = rows[::2]
            self._n_residuals = max(sum(len(part) for part in rows) for rows in self._residuals.values())

    def _keep_sample(self, number: int, frames: Sequence[Frame | None], measured: Measured, pose: TargetPose) -> None:
        """Keep the first good moment, and the first of each kind of trouble up to MAX_PROBLEMS."""
        kind = "" if pose.status is PoseStatus.OK else pose.status.value
        if kind in self._samples or (kind and len(self._samples.keys() - {""}) >= MAX_PROBLEMS):
            return
        views = enumerate(zip(self._setup.rig.names, frames, measured.spots, measured.seen, strict=True))
        self._samples[kind] = tuple(
            Sample(
                frame=number,
                side=side,
                image=frame.image,
                names=measured.names_in(s),
                spots=spots,
                seen=seen,
                source=frame.source,
                why=pose.why,
            )
            for s, (side, frame, spots, seen) in views
            if frame is not None
        )
