"""What a run's report needs, collected while it goes, in bounded memory but for the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.app.outputs import Summary
from armsight.calibrate.cameras import CameraCalibration, StereoCalibration
from armsight.measure.explain import content
from armsight.measure.pair import Measured, Setup
from armsight.optics import INTRINSICS, SIDES, Camera
from armsight.records import Frame, NamedCovariance, PoseStatus, TargetPose
from armsight.report import (
    CalibrationRun,
    CameraFit,
    MeasureRun,
    Parameter,
    Sample,
    calibration_report,
    measure_report,
)
from armsight.report.html import with_deviation
from armsight.store import write_text

Array = NDArray[np.float64]

MAX_RESIDUALS = 20_000
"""Residual vectors kept per camera: a cloud of more is no clearer; beyond it every second one goes."""

MAX_PROBLEMS = 2
"""Frames shown for what was wrong with them, beside one that was measured well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class About:
    """What a report says beside the measurement: more lines on its inputs, and the true pose per pair where known."""

    title: str = "Measurement"
    facts: Sequence[tuple[str, str]] = ()
    assumptions: Sequence[str] = ()
    truth: Sequence[RigidTransform] | None = None


class Collector:
    """Sees every step of a run and writes report.html at its end."""

    def __init__(self, setup: Setup, parent: str) -> None:
        self._setup = setup
        self._parent = parent
        self._poses: list[TargetPose] = []
        self._residuals: dict[str, list[Array]] = {side: [] for side in SIDES}
        self._n_residuals = 0
        self._every = 1
        self._samples: dict[str, tuple[Sample, ...]] = {}

    @property
    def poses(self) -> Sequence[TargetPose]:
        """The poses so far, one per pair."""
        return self._poses

    def add(self, left: Frame, right: Frame, measured: Measured, pose: TargetPose) -> None:
        """Take one pair, what was measured in it, and its pose in the parent frame."""
        number = len(self._poses)
        self._poses.append(pose)
        if number % self._every == 0:
            self._keep_residuals(number, pose)
        self._keep_sample(number, (left, right), measured, pose)

    def write(self, path: Path, summary: Summary, about: About) -> None:
        """Write the report of the pairs so far."""
        run = MeasureRun(
            poses=self._poses,
            rig=self._setup.rig,
            target=self._setup.target,
            residuals={side: np.vstack(rows) for side, rows in self._residuals.items() if rows},
            samples=[sample for pair in self._samples.values() for sample in pair],
            truth=None if about.truth is None else about.truth[: len(self._poses)],
            median_ms=summary.median_ms,
            p99_ms=summary.p99_ms,
            parent=self._parent,
            title=about.title,
            facts=about.facts,
            assumptions=about.assumptions,
            error=summary.error,
            consistency={} if summary.consistency is None else content(summary.consistency),
        )
        write_text(path, measure_report(run))

    def _keep_residuals(self, number: int, pose: TargetPose) -> None:
        vectors = pose.residual_px.reshape(-1, len(SIDES), 2)  # (n, side, u v), model minus measured
        if not len(vectors):
            return
        for i, side in enumerate(SIDES):
            self._residuals[side].append(np.column_stack([np.full(len(vectors), float(number)), -vectors[:, i]]))
        self._n_residuals += len(vectors)
        if self._n_residuals > MAX_RESIDUALS:
            self._every *= 2
            for side, rows in self._residuals.items():
                self._residuals[side] = rows[::2]
            self._n_residuals = sum(len(rows) for rows in self._residuals[SIDES[0]])

    def _keep_sample(self, number: int, pair: tuple[Frame, Frame], measured: Measured, pose: TargetPose) -> None:
        """Keep the first good pair, and the first of each kind of trouble up to MAX_PROBLEMS."""
        kind = "" if pose.status is PoseStatus.OK else pose.status.value
        if kind in self._samples or (kind and len(self._samples.keys() - {""}) >= MAX_PROBLEMS):
            return
        sides = zip(
            SIDES, pair, (measured.left, measured.right), (measured.left_seen, measured.right_seen), strict=True
        )
        self._samples[kind] = tuple(
            Sample(
                frame=number,
                side=side,
                image=frame.image,
                names=measured.names,
                spots=spots,
                seen=seen,
                source=frame.source,
                why=pose.why,
            )
            for side, frame, spots, seen in sides
        )


def write_camera_report(
    path: Path, done: CameraCalibration, *, board: str, rejected: Sequence[tuple[str, str]]
) -> None:
    """Write the report of one camera's calibration."""
    everything = (*rejected, *done.rejected)
    run = CalibrationRun(
        title="Calibration of a camera",
        board=board,
        cameras=[_fit("camera", done.camera, done.uv_px, done.residual_px, done.sources, done.view_rms_px)],
        parameters=_parameters("", done.camera, done.covariance),
        n_images=done.n_used + len(everything),
        n_used=done.n_used,
        rms_px=done.rms_px,
        holdout_rms_px=done.holdout_rms_px,
        rejected=everything,
        advice=done.advice,
    )
    write_text(path, calibration_report(run))


def write_stereo_report(
    path: Path,
    done: StereoCalibration,
    *,
    board: str,
    n_pairs: int,
    rejected: Sequence[tuple[str, str]],
    title: str = "Calibration of a pair of cameras",
    thing: str = "board",
    results: Sequence[tuple[str, str]] = (),
    facts: Sequence[tuple[str, str]] = (),
) -> None:
    """Write the report of a rig's calibration.

    thing: what the images show, if not a board. results: lines beside the alignment. facts: for the end of the page.
    """
    rig = done.rig
    parameters = [Parameter(name="baseline", value=rig.baseline_m * 1e3, std=done.baseline_std_m * 1e3, unit="mm")]
    for side in SIDES:
        parameters += _parameters(f"{side}.", rig.camera(side), rig.covariance)
    run = CalibrationRun(
        title=title,
        board=board,
        thing=thing,
        cameras=[
            _fit(
                side,
                rig.camera(side),
                done.uv_px[side],
                done.residual_px[side],
                tuple(names[i] for names in done.sources),
                done.view_rms_px,
            )
            for i, side in enumerate(SIDES)
        ],
        parameters=parameters,
        n_images=n_pairs,
        n_used=done.n_used,
        rms_px=done.rms_px,
        holdout_rms_px=done.holdout_rms_px,
        epipolar_rms_px=done.epipolar_rms_px,
        holdout_epipolar_rms_px=done.holdout_epipolar_rms_px,
        baseline_m=rig.baseline_m,
        metric=done.metric if done.metric_is_left_out else {},
        rejected=(*rejected, *done.rejected),
        alignment=[*alignment_lines(done), *results],
        facts=facts,
        advice=done.advice,
    )
    write_text(path, calibration_report(run))


def alignment_lines(done: StereoCalibration) -> list[tuple[str, str]]:
    """Return how parallel the pair stands, in words (Kapucu's alignment); as many digits as the deviations allow."""
    found, std = done.parallelism, done.parallelism.std or {}

    def line(words: str, name: str, unit: str, scale: float) -> tuple[str, str]:
        value, deviation = with_deviation(scale * getattr(found, name), scale * std[name] if name in std else None)
        return words, f"{value} +- {deviation} {unit}" if name in std else f"{value} {unit}"

    return [
        line("axes turn towards each other by", "convergence_rad", "mrad", 1e3),
        line("right axis points below the left one by", "vertical_rad", "mrad", 1e3),
        line("right image lower at infinity by", "vertical_px", "px", 1.0),
        line("right image turned by", "roll_rad", "mrad", 1e3),
        line("right camera lower by", "height_m", "mm", 1e3),
        line("right camera further forward by", "advance_m", "mm", 1e3),
    ]


def _fit(
    name: str, camera: Camera, uv_px: Array, residual_px: Array, sources: Sequence[str], view_rms_px: Sequence[float]
) -> CameraFit:
    return CameraFit(
        name=name,
        camera=camera,
        uv_px=uv_px,
        residual_px=-residual_px,  # the report speaks of measured minus model
        sources=tuple(sources),
        view_rms_px=np.asarray(view_rms_px, float),
    )


def _parameters(prefix: str, camera: Camera, covariance: NamedCovariance | None) -> list[Parameter]:
    std: Mapping[str, float] = covariance.std() if covariance else {}
    return [
        Parameter(
            name=f"{prefix}{name}", value=float(value), std=std.get(f"{prefix}{name}"), unit="px" if i < 5 else ""
        )
        for i, (name, value) in enumerate(zip(INTRINSICS, camera.intrinsics, strict=True))
    ]
