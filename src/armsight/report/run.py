"""What a report is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.measure.results import CameraPart, ConsistencyOutput
from armsight.optics import Camera, Rig
from armsight.records import Spots, Target, TargetPose, frozen_array
from armsight.records.result_parts import Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sample:
    """One image to show. spots: the matched ones, in the order of names; seen: all that were found.

    frame: position in the run. why: what was wrong with it, where something was.
    """

    frame: int
    side: str
    image: NDArray[np.uint8]
    names: tuple[str, ...]
    spots: Spots
    seen: Spots
    source: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasureRun:
    """A finished (or broken off) measurement.

    poses: one per pair of frames, in order, in the frame parent. residuals: per camera (m, 3): frame, and measured
    minus projected u, v in px, of all sights but n_aside, known too badly to judge by. samples: images to show. truth:
    the true pose per frame, in the same frame.
    facts: more lines for the table of inputs. consistency: what the check of the residuals says; None where there was
    none. by_camera: each one's part, of a rig that is no pair. timed: whether the times of the frames are known and not
    assumed. stills: whether they are single shots, with no track. T_parent_rig: where the cameras are in the
    parent frame. recordings: files that the frames are in.
    """

    poses: Sequence[TargetPose]
    rig: Rig
    target: Target
    verdict: Verdict
    residuals: Mapping[str, Array] = field(default_factory=dict)
    samples: Sequence[Sample] = ()
    truth: Sequence[RigidTransform] | None = None
    median_ms: float | None = None
    p99_ms: float | None = None
    parent: str = "rig"
    title: str = "Measurement"
    subtitle: str = ""
    facts: Sequence[tuple[str, str]] = ()
    assumptions: Sequence[str] = ()
    consistency: ConsistencyOutput | None = None
    n_aside: int = 0
    by_camera: Mapping[str, CameraPart] = field(default_factory=dict)
    T_parent_rig: RigidTransform | None = None
    timed: bool = True
    stills: bool = False
    recordings: Sequence[str] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "poses", tuple(self.poses))
        object.__setattr__(
            self, "residuals", {side: frozen_array(side, rows, (None, 3)) for side, rows in self.residuals.items()}
        )
        if not set(self.residuals) <= set(self.rig.names):
            raise Inconsistent(f"residuals of {', '.join(self.residuals)}: the cameras are {', '.join(self.rig.names)}")
        if self.truth is not None and len(self.truth) != len(self.poses):
            raise Inconsistent(f"{len(self.truth)} true poses for {len(self.poses)} measured ones")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardPicture:
    """A small picture of one view of a board. jpeg: the file's bytes, of the whole image, width by height px at first.

    uv_px (n, 2): the points found, in px of the image; residual_px (n,): distance of each from the model's.
    """

    name: str
    jpeg: bytes
    width: int
    height: int
    uv_px: Array
    residual_px: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "uv_px", frozen_array("uv_px", self.uv_px, (None, 2)))
        object.__setattr__(self, "residual_px", frozen_array("residual_px", self.residual_px, (len(self.uv_px),)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardViews:
    """The views of a calibration's board. parent: the axes' name. outline_m (k, 3): the board's edge in its own axes.

    T_parent_board: one per view; cameras: name, camera and pose of each, in the same axes. names, rms_px: of each view.
    pictures: of those that were kept, by their view's position; several of one view where several cameras saw it.
    """

    parent: str
    outline_m: Array
    T_parent_board: Sequence[RigidTransform]
    cameras: Sequence[tuple[str, Camera, RigidTransform]]
    names: Sequence[str]
    rms_px: Sequence[float]
    pictures: Sequence[tuple[int, BoardPicture]] = ()
