"""Cameras and rigs from images of a printed board."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from armsight.api.results import Result, Row
from armsight.app.calibrate.board_images import Seen, count_again, in_parallel, see_board
from armsight.app.calibrate.mirrors import mirrors_output
from armsight.app.calibrate.zoom import add_setting
from armsight.app.requests.calibrate_cameras import CameraJob, MirrorsJob, StereoJob, ZoomFlags, ZoomValue
from armsight.arrays import Image
from armsight.calibrate import cameras as solvers
from armsight.calibrate.cameras import BoardOptions, CameraCalibration, StereoCalibration
from armsight.calibrate.mirrors import calibration as mirror_solver
from armsight.calibrate.mirrors.calibration import MirrorCalibration
from armsight.errors import BadImage, Inconsistent, NotEnoughData, UsageError
from armsight.measure.boards import DETECTORS, find_two_boards
from armsight.ops.arrays import ImageLike, as_images
from armsight.ops.checks import speaks_python
from armsight.optics import Camera, Rig
from armsight.records import BoardView, Frame, NoiseModel, NotSeen, Target, require_kind
from armsight.records.output import with_std
from armsight.records.result_parts import RejectedFile
from armsight.store import parse_board, write_camera
from armsight.store.saving import YAML, file_to_write

if TYPE_CHECKING:
    import plotly.graph_objects as go

Images = ImageLike | Iterable[ImageLike]
Detector = Literal["auto", "quick", "classic", "sectors", "xcorner"]
Rejected = tuple[RejectedFile, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class _BoardResult(Result):
    """What calibrations from boards share."""

    detail: CameraCalibration | StereoCalibration

    @property
    def rejected(self) -> Rejected:
        """(file, why) of each image left out."""
        return self.detail.rejected

    @property
    def rms_px(self) -> float:
        """Root mean square reprojection residual in px."""
        return self.detail.rms_px

    @property
    def left_out_rms_px(self) -> float | None:
        """The same on images left out of the fit; None where there were too few."""
        return self.detail.holdout_rms_px

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name, the unit in the name."""
        return self.detail.std

    @property
    def advice(self) -> tuple[str, ...]:
        """What would make the result surer."""
        return self.detail.advice

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as `armsight calibrate ... --json` gives them."""
        return self.detail.to_dict()

    def _fit_rows(self) -> list[Row]:
        left_out = "" if self.left_out_rms_px is None else f"; {self.left_out_rms_px:.3g} px on images left out"
        rows = [("reprojection", f"{self.rms_px:.3g} px RMS{left_out}"), ("rejected", str(len(self.rejected)))]
        return rows + [("advice", text) for text in self.advice]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class CameraResult(_BoardResult):
    """One camera's calibration. detail: residuals, covariance and all else."""

    detail: CameraCalibration

    @property
    def camera(self) -> Camera:
        """What was found."""
        return self.detail.camera

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Camera from {self.detail.n_used} images of a board"

    def rows(self) -> list[Row]:
        """Return the intrinsics with standard deviations, and how well they fit."""
        names = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3")
        std = self.detail.covariance.std()
        values = zip(names, self.camera.intrinsics.tolist(), strict=True)
        rows = [(name, with_std(v, std.get(name), "px" if i < 5 else "")) for i, (name, v) in enumerate(values)]
        return rows + self._fit_rows()

    @speaks_python(ZoomFlags)
    def save(
        self,
        path: str | PathLike[str],
        *,
        zoom: float | None = None,
        pupil_m: float | None = None,
        pupil_std_m: float = ZoomFlags.pupil_std,
        noise: NoiseModel | None = None,
    ) -> Path:
        """Write camera.yaml with the covariance, and return its path.

        zoom: of a zoom lens, the setting at which the images were taken; the file keeps its other settings. pupil_m,
        pupil_std_m: where the centre of projection stands along the axis, forward. noise: of calibrate_noise.
        """
        file, found = file_to_write(path, *YAML), self.detail
        if zoom is None:
            write_camera(file, self.camera, covariance=found.covariance, rms_px=self.rms_px, noise=noise)
        else:
            add_setting(file, ZoomValue(zoom=zoom, pupil_m=pupil_m, pupil_std_m=pupil_std_m), found, noise=noise)
        return file

    def plot(self) -> go.Figure:
        """Return a plotly figure of the residuals over the image."""
        return _residual_figure({"camera": (self.detail.uv_px, self.detail.residual_px)}, self.title)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class RigResult(_BoardResult):
    """A rig's calibration, of two cameras or of a mirror rig. rig: what it gives; detail: all else."""

    rig: Rig
    detail: StereoCalibration

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        return f"Rig ({self.rig.kind}) from {self.detail.n_used} pairs of views of a board"

    def rows(self) -> list[Row]:
        """Return baseline and focal lengths with standard deviations, and how well they fit."""
        std = self.std
        rows = [("baseline", with_std(self.rig.baseline_m, std.get("baseline_m"), "mm", scale=1e3))]
        for side in ("left", "right"):
            values = zip(("fx", "fy", "cx", "cy"), self.rig.camera(side).intrinsics[:4].tolist(), strict=True)
            rows += [(f"{side} {name}", with_std(v, std.get(f"{side}.{name}_px"), "px")) for name, v in values]
        return [*rows, ("epipolar", f"{self.detail.epipolar_rms_px:.3g} px RMS"), *self._fit_rows()]

    def save(self, path: str | PathLike[str]) -> Path:
        """Write rig.yaml with the covariance, and return its path."""
        return self.rig.save(path)

    def plot(self) -> go.Figure:
        """Return a plotly figure of both cameras' residuals over the image."""
        found = self.detail
        return _residual_figure({s: (found.uv_px[s], found.residual_px[s]) for s in ("left", "right")}, self.title)


@speaks_python(CameraJob)
def calibrate_camera(
    images: Images,
    board: str | Target,
    *,
    options: BoardOptions | None = None,
    detector: Detector = "auto",
    bits: int | None = None,
) -> CameraResult:
    """Return the camera that took the images of a printed board.

    Parameters
    ----------
    images
        uint8 arrays (h, w) or (h, w, 3), paths, or a folder; ten or more, the board tilted differently in each.
    board
        'checkerboard:9x6:0.025' (inner corners, side of a square in m), 'circles:CxR:PITCH', 'acircles:CxR:PITCH',
        'charuco:CxR:SQUARE:MARKER:DICTIONARY', 'aprilgrid:CxR:TAG:SPACING', a file (Kalibr's too), or a Target.
    options
        What is held fixed, the kind of lens, and how outliers are rejected.
    detector
        How checkerboards are looked for.
    bits
        Of the light in 16-bit images, such as 12.

    Raises
    ------
    NotEnoughData
        The board is seen in too few images.
    Degenerate, Undetermined
        The views leave something open; the message names it.
    Inconsistent
        Images of different sizes.
    NotConverged
        The fit found no answer.
    BadImage
        One of them is no image.
    """
    target, options = _board(board), _options(options)
    seen = _seen(as_images(images, "image", bits), target, _detector(detector))
    views = [view for _, view in seen if isinstance(view, BoardView)]
    missed = tuple(RejectedFile(name, view.why) for name, view in seen if isinstance(view, NotSeen))
    _require(views, missed, target)
    done = solvers.calibrate_camera(views, target, options)
    return CameraResult(detail=replace(done, rejected=(*missed, *done.rejected)))


@speaks_python(StereoJob)
def calibrate_stereo(
    left_images: Images,
    right_images: Images,
    board: str | Target,
    *,
    options: BoardOptions | None = None,
    detector: Detector = "auto",
    bits: int | None = None,
) -> RigResult:
    """Return the rig of two cameras that took images of a printed board at the same moments.

    Parameters
    ----------
    left_images
        As calibrate_camera takes them.
    right_images
        As many, in the same order.
    board
        As calibrate_camera takes it.
    options, detector, bits
        As calibrate_camera takes them.

    Raises
    ------
    Inconsistent
        Not as many left as right images; else as calibrate_camera.
    """
    target, options = _board(board), _options(options)
    pairs = _paired(as_images(left_images, "left image", bits), as_images(right_images, "right image", bits))
    how = _detector(detector)
    left, right, missed = _both(_seen(pairs[0], target, how), _seen(pairs[1], target, how))
    _require(left, missed, target)
    done = solvers.calibrate_stereo(left, right, target, options)
    done = replace(done, n_pairs=len(pairs[0]), rejected=(*missed, *done.rejected))
    return RigResult(rig=done.rig, detail=done)


@speaks_python(MirrorsJob)
def calibrate_mirrors(
    images: Images,
    board: str | Target,
    *,
    thickness_m: float | None = None,
    options: BoardOptions | None = None,
) -> RigResult:
    """Return the mirror rig whose complex images show the board in both views.

    Parameters
    ----------
    images
        As calibrate_camera takes them, each of both views over each other.
    board
        As calibrate_camera takes it.
    thickness_m
        Of the glass plate in m; None to find it, 0 for none.
    options
        What is held fixed, and how outliers are rejected.

    Raises
    ------
    NotEnoughData
        The board is seen twice in too few images; else as calibrate_camera.
    """
    target, options = _board(board), _options(options)
    seen = list(in_parallel(lambda item: (item[0], _two(item[1], target)), as_images(images, "image")))
    missed = tuple(RejectedFile(name, views.why) for name, views in seen if isinstance(views, NotSeen))
    found = [views for _, views in seen if not isinstance(views, NotSeen)]
    _require([left for left, _ in found], missed, target)
    done: MirrorCalibration = mirror_solver.calibrate_mirrors(
        [left for left, _ in found], [right for _, right in found], target, thickness_m=thickness_m, options=options
    )
    return RigResult(rig=done.rig, detail=mirrors_output(done, missed))


def _board(board: str | Target) -> Target:
    require_kind("board", board, str, Target, cure="Give 'checkerboard:9x6:0.025' or a Target, see calibrate_camera")
    target = parse_board(board) if isinstance(board, str) else board
    if not target.is_board:
        raise UsageError(
            "the board is a target of lights", consequence="It is in no image", cure="Give a printed board"
        )
    return target


def _options(options: BoardOptions | None) -> BoardOptions | None:
    require_kind("options", options, BoardOptions, NoneType, cure="Give BoardOptions(...)")
    return options


def _detector(detector: str) -> str:
    if detector not in DETECTORS:
        raise UsageError(f"there is no detector {detector!r}", cure=f"Use one of: {', '.join(DETECTORS)}")
    return detector


def _seen(images: list[tuple[str, Image]], board: Target, detector: str) -> list[tuple[str, Seen]]:
    def look(item: tuple[str, Image]) -> tuple[str, Seen]:
        name, image = item
        return name, see_board(Frame(image=image.copy(), t_s=0.0, sequence=0, source=name), board, detector)

    return list(in_parallel(look, images))


def _two(image: Image, board: Target) -> tuple[BoardView, BoardView] | NotSeen:
    try:
        return find_two_boards(image, board)
    except BadImage as error:
        return NotSeen(error.cause, error.unseen)


def _paired(
    left: list[tuple[str, Image]], right: list[tuple[str, Image]]
) -> tuple[list[tuple[str, Image]], list[tuple[str, Image]]]:
    if len(left) != len(right):
        raise Inconsistent(
            f"{len(left)} left images and {len(right)} right images",
            consequence="Nobody knows which belong together",
            cure="Give one left and one right image of each moment, in the same order",
        )
    return left, right


def _both(
    left: list[tuple[str, Seen]], right: list[tuple[str, Seen]]
) -> tuple[list[BoardView], list[BoardView], Rejected]:
    views: tuple[list[BoardView], list[BoardView]] = [], []
    missed: list[RejectedFile] = []
    for (left_name, a), (right_name, b) in zip(left, right, strict=True):
        if isinstance(a, BoardView) and isinstance(b, BoardView):
            views[0].append(a)
            views[1].append(b)
        both = ((left_name, a), (right_name, b))
        missed += [RejectedFile(name, view.why) for name, view in both if isinstance(view, NotSeen)]
    return views[0], views[1], tuple(missed)


def _require(views: list[BoardView], missed: Rejected, board: Target) -> None:
    if not views:
        first = f"; in the first, {missed[0][0]}: {missed[0][1]}" if missed else ": there are none"
        raise NotEnoughData(
            f"the board was found in none of the images{first}",
            consequence="Nothing was calibrated",
            cure=count_again(board),
        )


def _residual_figure(views: Mapping[str, tuple[Any, Any]], title: str) -> go.Figure:
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=len(views), subplot_titles=list(views))
    for column, (uv, residual) in enumerate(views.values(), 1):
        size = np.linalg.norm(residual, axis=1)
        text = [f"({dx:+.3f}, {dy:+.3f}) px" for dx, dy in residual]
        marker = {"color": size, "size": 5, "colorscale": "Viridis", "colorbar": {"title": "px"}}
        trace = go.Scatter(x=uv[:, 0], y=uv[:, 1], mode="markers", marker=marker, text=text, showlegend=False)
        figure.add_trace(trace, row=1, col=column)
        figure.update_yaxes(autorange="reversed", scaleanchor=f"x{column if column > 1 else ''}", row=1, col=column)
    figure.update_layout(title=title)
    return figure
