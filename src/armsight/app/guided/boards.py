"""Cameras and rigs from a board that a person shows: coverage, tilt, live standard deviations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.app.guided.step import Figure, Hint, Next, Sample, StepResult
from armsight.app.live.station import MeasurementProcess
from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.cameras import calibrate_camera as solve_camera
from armsight.calibrate.cameras import calibrate_stereo as solve_stereo
from armsight.calibrate.cameras.preconditions import COVERED, image_share
from armsight.drivers import read_image
from armsight.errors import BadImage, DataRefused, NotEnoughData
from armsight.file_names import report_path
from armsight.ops.calibrate_cameras import calibrate_camera, calibrate_stereo
from armsight.ops.calibration.board_images import see_board
from armsight.optics import SIDES
from armsight.records import BoardView, Frame, NotSeen, Progress, Target
from armsight.store import parse_board

CELLS = 3
"""A picture is parted into so many columns and rows."""
ENOUGH = 15
"""Samples from which a calibration rests on more than their number: later ones gain little."""
FEWEST = 5
"""Samples from which standard deviations are shown."""
TILTED = 0.12
"""A board whose scale differs by this share over the picture is tilted by some 15 to 30 degrees, which a focal length
needs."""
TILTED_SHARE = 0.5
SAME = 0.01
"""A board of which all points are within this share of a picture's width from where they were adds nothing: it would
only feign certainty."""


@dataclass(slots=True, kw_only=True)
class BoardCalibration:
    """Pairs of pictures of a board, for a rig; or those of one camera, for its lens.

    sides: left, right or both. folder: takes the pictures. out: camera.yaml or rig.yaml.
    """

    board: str
    folder: Path
    out: Path
    sides: tuple[str, ...] = SIDES
    _views: list[tuple[BoardView, ...]] = field(default_factory=list)
    _names: list[str] = field(default_factory=list)
    _taken: int = 0
    _solved: tuple[tuple[str, ...], tuple[float, Mapping[str, float]] | str] | None = None

    @property
    def name(self) -> str:
        """The step's key."""
        return "stereo" if len(self.sides) > 1 else f"camera-{self.sides[0]}"

    @property
    def samples(self) -> tuple[Sample, ...]:
        """The boards accepted so far."""
        board = parse_board(self.board)
        return tuple(
            Sample(name=name, detail=f"{len(views[0])} points, tilt {100 * tilt(views[0], board):.0f} %")
            for name, views in zip(self._names, self._views, strict=True)
        )

    def coverage(self) -> dict[str, tuple[int, ...]]:
        """Return per camera how many boards reach into each cell of its picture."""
        return {side: tuple(self._cells(i).ravel().tolist()) for i, side in enumerate(self.sides)}

    def hint(self) -> Hint:
        """Return what is missing most: a first board, a corner of a picture, tilt, more of them."""
        if not self._views:
            return Hint(what=Next.SHOW_BOARD)
        for i, side in enumerate(self.sides):
            cells = self._cells(i)
            if cells.min() == 0:
                row, column = np.unravel_index(int(np.argmin(cells)), cells.shape)
                return Hint(what=Next.TO_CELL, side=side, cell=(int(column), int(row)))
            if self._share(i) < COVERED:  # each part is reached, its outer half is not
                return Hint(what=Next.TO_CELL, side=side, cell=self._bare_corner(i))
        board = parse_board(self.board)
        tilted = np.mean([tilt(views[0], board) > TILTED for views in self._views])
        if tilted < TILTED_SHARE:
            return Hint(what=Next.TILT)
        return Hint(what=Next.RUN if len(self._views) >= ENOUGH else Next.MORE)

    def spread(self) -> tuple[tuple[str, str], ...]:
        """Return the standard deviations of what the boards so far give."""
        solved = self._solve()
        if solved is None:
            return ()
        if isinstance(solved, str):
            return (("", solved),)
        _, std = solved
        return tuple(
            (words, f"{scale * std[name]:.3g} {unit}".rstrip())
            for name, (words, scale, unit) in self._shown().items()
            if name in std
        )

    def accept(self, station: MeasurementProcess) -> Sample:
        """Take the pictures of now. Raises BadImage where the board is not seen whole in each that counts, or is where
        it was before."""
        if not self._views:
            self._clear()
        name = f"{self._taken:03d}"
        files = {side: self.folder / side / f"{name}.png" for side in SIDES}
        station.save_pair(files["left"], files["right"])
        try:
            views = tuple(self._seen(side, files[side]) for side in self.sides)
            self._require_moved(views[0])
        except BadImage:
            for file in files.values():
                file.unlink(missing_ok=True)
            raise
        self._taken += 1
        self._views.append(views)
        self._names.append(name)
        return self.samples[-1]

    def _seen(self, side: str, file: Path) -> BoardView:
        frame = Frame(image=read_image(file), t_s=0.0, sequence=self._taken, source=f"{side}/{file.name}")
        seen = see_board(frame, parse_board(self.board))
        if isinstance(seen, NotSeen):
            raise BadImage(
                f"{side} camera: {seen.why}",
                consequence="The picture was not taken",
                cure="Hold the board still, whole in the picture, evenly lit",
            )
        return seen

    def _require_moved(self, view: BoardView) -> None:
        """Raise BadImage where an accepted view of the first side shows the board at the same position."""
        for name, before in zip(self._names, self._views, strict=True):
            _, now, then = np.intersect1d(view.index, before[0].index, return_indices=True)
            way_px = np.linalg.norm(view.uv_px[now] - before[0].uv_px[then], axis=1)
            if len(way_px) and way_px.max() < SAME * view.width:
                raise BadImage(
                    f"the board is where it was in picture {name}",
                    consequence="The picture was not taken",
                    cure="Move it, or tilt it another way",
                )

    def drop(self, index: int) -> None:
        """Forget a board and its pictures."""
        name = self._names.pop(index)
        del self._views[index]
        for side in SIDES:
            (self.folder / side / f"{name}.png").unlink(missing_ok=True)

    def run(self, progress: Progress) -> StepResult:
        """Calibrate from the accepted pictures, with cross-validation; write the file and its report."""
        if len(self._views) < FEWEST:
            raise NotEnoughData(
                f"{len(self._views)} boards were accepted",
                consequence="Nothing was calibrated",
                cure=f"Accept {FEWEST} at least, better {ENOUGH}",
            )
        folders = [str(self.folder / side) for side in self.sides]
        if len(self.sides) > 1:
            rig = calibrate_stereo(folders[0], folders[1], self.board, out=self.out, progress=progress)
            rows = [("RMS", f"{rig.rms_px:.3f} px"), ("baseline", f"{1e3 * rig.baseline_m:.2f} mm")]
            rows += [("± baseline", f"{1e3 * rig.std['baseline_m']:.3f} mm (1 σ)")]
            left_out, verdict = rig.holdout_rms_px, rig.verdict_
        else:
            camera = calibrate_camera(folders[0], self.board, out=self.out, progress=progress)
            rows = [("RMS", f"{camera.rms_px:.3f} px"), ("focal length", f"{camera.fx_px:.1f} px")]
            rows += [("± focal length", f"{camera.std['fx_px']:.2f} px (1 σ)")]
            left_out, verdict = camera.holdout_rms_px, camera.verdict_
        rows += [("RMS of boards left out", "–" if left_out is None else f"{left_out:.3f} px")]
        return StepResult(verdict=verdict, rows=tuple(rows), file=self.out, report=report_path(self.out))

    def _clear(self) -> None:
        """Take away what an earlier calibration left, so that only what was accepted counts."""
        for side in SIDES:
            for file in (self.folder / side).glob("*.png"):
                file.unlink()

    def figures(self) -> tuple[Figure, ...]:
        """Return residual, standard deviations and coverage, for a plot against the number of boards."""
        solved = self._solve()
        if solved is None or isinstance(solved, str):
            return ()
        rms_px, std = solved
        out = [Figure(name="residual, RMS", value=rms_px, unit="px")]
        out += [
            Figure(name=f"± {words}", value=scale * std[name], unit=unit)
            for name, (words, scale, unit) in self._shown().items()
            if name in std
        ]
        covered = min(self._share(i) for i in range(len(self.sides)))
        return (*out, Figure(name="picture covered", value=100.0 * covered, unit="%"))

    def _shown(self) -> dict[str, tuple[str, float, str]]:
        if len(self.sides) > 1:
            return {
                "left.fx": ("left focal length", 1.0, "px"),
                "right.fx": ("right focal length", 1.0, "px"),
                "baseline_m": ("baseline", 1e3, "mm"),
            }
        return {"fx": ("focal length", 1.0, "px"), "cx": ("principal point", 1.0, "px"), "k1": ("k1", 1.0, "")}

    def _solve(self) -> tuple[float, Mapping[str, float]] | str | None:
        """Return the residual in px and the standard deviations of what the boards so far give; why not, or None."""
        if len(self._views) < FEWEST:
            return None
        names = tuple(self._names)
        if self._solved is None or self._solved[0] != names:
            board, options = parse_board(self.board), BoardOptions(folds=0)
            columns = [[views[i] for views in self._views] for i in range(len(self.sides))]
            try:
                if len(self.sides) > 1:
                    rig = solve_stereo(columns[0], columns[1], board, options)
                    self._solved = names, (rig.rms_px, rig.std)
                else:
                    camera = solve_camera(columns[0], board, options)
                    self._solved = names, (camera.rms_px, camera.covariance.std())
            except DataRefused as error:
                self._solved = names, str(error.cause)
        return self._solved[1]

    def _share(self, i: int) -> float:
        """Return the share of a camera's image that lies between all points, as its report tells it."""
        views = [views[i] for views in self._views]
        return image_share(np.concatenate([view.uv_px for view in views]), views[0].width, views[0].height)

    def _bare_corner(self, i: int) -> tuple[int, int]:
        """Return the cell (column, row) of the corner that is farthest from all points."""
        view = self._views[0][i]
        uv = np.concatenate([views[i].uv_px for views in self._views]) / [view.width, view.height]
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        far = int(np.linalg.norm(uv[None] - corners[:, None], axis=2).min(axis=1).argmax())
        column, row = (CELLS - 1) * corners[far]
        return int(column), int(row)

    def _cells(self, i: int) -> NDArray[np.int64]:
        count = np.zeros((CELLS, CELLS), dtype=np.int64)
        for views in self._views:
            view = views[i]
            cell = (view.uv_px / [view.width, view.height] * CELLS).astype(int).clip(0, CELLS - 1)
            for column, row in {(int(c), int(r)) for c, r in cell}:
                count[row, column] += 1
        return count


def tilt(view: BoardView, board: Target) -> float:
    """Return by which share a board's scale differs over its picture: 0 facing the camera; seen in part or whole."""
    flat = board.xyz_m[view.index][:, :2]
    if len(flat) < 4:
        return 0.0
    H, _ = cv2.findHomography(flat, view.uv_px)
    if H is None:
        return 0.0
    depth = np.column_stack([flat, np.ones(len(flat))]) @ H[2]
    return float(1.0 - depth.min() / depth.max()) if depth.min() > 0.0 else 0.0
