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
from armsight.calibrate.cameras import BoardOptions, CameraCalibration, CamerasCalibration, StereoCalibration
from armsight.calibrate.cameras import calibrate_camera as solve_camera
from armsight.calibrate.cameras import calibrate_stereo as solve_stereo
from armsight.calibrate.cameras.many import ManySolved, solve_cameras
from armsight.calibrate.cameras.many_result import result_of
from armsight.calibrate.cameras.preconditions import COVERED, image_share
from armsight.drivers import read_image
from armsight.errors import BadImage, DataRefused, NotEnoughData
from armsight.file_names import report_path
from armsight.ops.calibrate_cameras import calibrate_camera, calibrate_stereo
from armsight.ops.calibrate_rig import calibrate_cameras
from armsight.ops.calibration.board_images import see_board
from armsight.optics import PLACE, SIDES
from armsight.records import BoardView, Frame, NotSeen, Progress, Target
from armsight.store import parse_board
from armsight.store.cell_file import COMPLEX

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
    """Moments of pictures of a board, for a rig; or those of one camera, for its lens.

    sides: the pictures that count: left and right, both of which must show the board; one camera's, or the one with
    mirrors; or some cameras', of which two must. folder: takes them. out: camera.yaml or rig.yaml.
    """

    board: str
    folder: Path
    out: Path
    sides: tuple[str, ...] = SIDES
    _views: list[tuple[BoardView | None, ...]] = field(default_factory=list)
    _names: list[str] = field(default_factory=list)
    _taken: int = 0
    _solved: tuple[tuple[str, ...], tuple[Figure, ...] | str] | None = None

    @property
    def name(self) -> str:
        """The step's key."""
        if len(self.sides) > 1:
            return "stereo" if self.sides == SIDES else "cameras"
        return f"camera-{SIDES[0] if self.sides == (COMPLEX,) else self.sides[0]}"

    @property
    def samples(self) -> tuple[Sample, ...]:
        """The boards accepted so far."""
        return tuple(Sample(name=name, detail=self._detail(i)) for i, name in enumerate(self._names))

    def _detail(self, i: int) -> str:
        seen = self._seen_by(i)
        first = next(iter(seen.values()))
        who = f", seen by {', '.join(seen)}" if self.name == "cameras" else ""
        return f"{len(first)} points, tilt {100 * tilt(first, parse_board(self.board)):.0f} %{who}"

    def _seen_by(self, i: int) -> dict[str, BoardView]:
        """Return the views of a moment by camera, of those that show the board."""
        return {side: view for side, view in zip(self.sides, self._views[i], strict=True) if view is not None}

    def _of(self, side: str) -> list[BoardView]:
        """Return the views of one camera."""
        k = self.sides.index(side)
        return [view for views in self._views if (view := views[k]) is not None]

    def coverage(self) -> dict[str, tuple[int, ...]]:
        """Return per camera how many boards reach into each cell of its picture."""
        return {side: tuple(self._cells(side).ravel().tolist()) for side in self.sides}

    def hint(self) -> Hint:
        """Return what is missing most: a first board, a corner of a picture, tilt, more of them."""
        if not self._views:
            return Hint(what=Next.SHOW_BOARD)
        if apart := self._apart():
            return Hint(what=Next.JOIN, side=apart)
        for side in self.sides:
            cells = self._cells(side)
            if cells.min() == 0:
                row, column = np.unravel_index(int(np.argmin(cells)), cells.shape)
                return Hint(what=Next.TO_CELL, side=side, cell=(int(column), int(row)))
            if self._share(side) < COVERED:  # each part is reached, its outer half is not
                return Hint(what=Next.TO_CELL, side=side, cell=self._bare_corner(side))
        board = parse_board(self.board)
        seen = [next(iter(self._seen_by(i).values())) for i in range(len(self._views))]
        tilted = np.mean([tilt(view, board) > TILTED for view in seen])
        if tilted < TILTED_SHARE:
            return Hint(what=Next.TILT)
        return Hint(what=Next.RUN if len(self._views) >= ENOUGH else Next.MORE)

    def _apart(self) -> str:
        """Return a camera that no moments join to the first one that saw a board, empty where they join all."""
        joined, known = set(self._seen_by(0)), 0
        while len(joined) > known:
            known = len(joined)
            moments = [set(self._seen_by(i)) for i in range(len(self._views))]
            joined = joined.union(*(one for one in moments if one & joined))
        return next((side for side in self.sides if side not in joined), "")

    def spread(self) -> tuple[tuple[str, str], ...]:
        """Return the standard deviations of what the boards so far give."""
        solved = self._solve()
        if isinstance(solved, str):
            return (("", solved),)
        return tuple((one.name.removeprefix("± "), f"{one.value:.3g} {one.unit}".rstrip()) for one in solved[1:])

    def accept(self, station: MeasurementProcess) -> Sample:
        """Take the pictures of now. Raises BadImage where too few that count show the board, or it is where it was."""
        if not self._views:
            self._clear()
        name = f"{self._taken:03d}"
        files = {side: self.folder / side / f"{name}.png" for side in self.sides}
        station.save(files)
        try:
            views = self._seen(files)
            self._require_moved(views)
        except BadImage:
            for file in files.values():
                file.unlink(missing_ok=True)
            raise
        self._taken += 1
        self._views.append(views)
        self._names.append(name)
        return self.samples[-1]

    def _seen(self, files: Mapping[str, Path]) -> tuple[BoardView | None, ...]:
        """Return what each picture shows of the board. Raises BadImage where fewer show it than are needed."""
        seen = []
        for side, file in files.items():
            frame = Frame(image=read_image(file), t_s=0.0, sequence=self._taken, source=f"{side}/{file.name}")
            seen.append(see_board(frame, parse_board(self.board)))
        missed = {side: one.why for side, one in zip(files, seen, strict=True) if isinstance(one, NotSeen)}
        if len(seen) - len(missed) < min(len(seen), len(SIDES)):
            raise BadImage(
                "; ".join(f"{side} camera: {why}" for side, why in missed.items()),
                consequence="The picture was not taken",
                cure="Hold the board still, whole in the picture, evenly lit",
            )
        return tuple(None if isinstance(one, NotSeen) else one for one in seen)

    def _require_moved(self, views: tuple[BoardView | None, ...]) -> None:
        """Raise BadImage where the first camera that sees it in an accepted moment too has it at the same position."""
        for name, before in zip(self._names, self._views, strict=True):
            both = ((a, b) for a, b in zip(views, before, strict=True) if a is not None and b is not None)
            view, old = next(both, (None, None))
            if view is None or old is None:
                continue
            _, now, then = np.intersect1d(view.index, old.index, return_indices=True)
            way_px = np.linalg.norm(view.uv_px[now] - old.uv_px[then], axis=1)
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
        for side in self.sides:
            (self.folder / side / f"{name}.png").unlink(missing_ok=True)

    def run(self, progress: Progress) -> StepResult:
        """Calibrate from the accepted pictures, with cross-validation; write the file and its report."""
        if len(self._views) < FEWEST:
            raise NotEnoughData(
                f"{len(self._views)} boards were accepted",
                consequence="Nothing was calibrated",
                cure=f"Accept {FEWEST} at least, better {ENOUGH}",
            )
        done, rows = self._calibrated(progress)
        left_out = done.holdout_rms_px
        rows = [("RMS", f"{done.rms_px:.3f} px"), *rows]
        rows += [("RMS of boards left out", "–" if left_out is None else f"{left_out:.3f} px")]
        return StepResult(verdict=done.verdict_, rows=tuple(rows), file=self.out, report=report_path(self.out))

    def _calibrated(
        self, progress: Progress
    ) -> tuple[CameraCalibration | StereoCalibration | CamerasCalibration, list[tuple[str, str]]]:
        """Return what the command gives, and what of it is told beside the residuals."""
        folders, board, out = [str(self.folder / side) for side in self.sides], self.board, self.out
        if self.name == "cameras":
            many = calibrate_cameras(dict(zip(self.sides, folders, strict=True)), board, out=out, progress=progress)
            places = {name: ", ".join(f"{1e3 * x:.1f}" for x in at) for name, at in many.position_m.items()}
            doubts = [(one.name, f"{one.value:.3g} {one.unit} (1 σ)") for one in _doubts(many.solved, self.sides)]
            return many, [*((f"{name} place", f"{at} mm") for name, at in places.items()), *doubts]
        if self.name == "stereo":
            rig = calibrate_stereo(folders[0], folders[1], board, out=out, progress=progress)
            baseline = ("baseline", f"{1e3 * rig.baseline_m:.2f} mm")
            return rig, [baseline, ("± baseline", f"{1e3 * rig.std['baseline_m']:.3f} mm (1 σ)")]
        lens = calibrate_camera(folders[0], board, out=out, progress=progress)
        focal = ("focal length", f"{lens.fx_px:.1f} px")
        return lens, [focal, ("± focal length", f"{lens.std['fx_px']:.2f} px (1 σ)")]

    def _clear(self) -> None:
        """Take away what an earlier calibration left, so that only what was accepted counts."""
        for side in self.sides:
            for file in (self.folder / side).glob("*.png"):
                file.unlink()

    def figures(self) -> tuple[Figure, ...]:
        """Return residual, standard deviations and coverage, for a plot against the number of boards."""
        solved = self._solve()
        if not solved or isinstance(solved, str):
            return ()
        covered = min(map(self._share, self.sides))
        return (*solved, Figure(name="picture covered", value=100.0 * covered, unit="%"))

    def _solve(self) -> tuple[Figure, ...] | str:
        """Return the residual and the standard deviations of the boards so far, none of too few; or why not."""
        if len(self._views) < FEWEST:
            return ()
        names = tuple(self._names)
        if self._solved is None or self._solved[0] != names:
            try:
                self._solved = names, self._figures()
            except DataRefused as error:
                self._solved = names, str(error.cause)
        return self._solved[1]

    def _figures(self) -> tuple[Figure, ...]:
        board, options = parse_board(self.board), BoardOptions(folds=0)
        columns = {side: [views[i] for views in self._views] for i, side in enumerate(self.sides)}
        if self.name == "cameras":
            many = solve_cameras(columns, board, options)
            rms_px, doubts = result_of(many, len(self._views)).rms_px, _doubts(many, self.sides)
        else:
            whole = list(map(self._of, self.sides))
            if self.name == "stereo":
                rig = solve_stereo(whole[0], whole[1], board, options)
                rms_px, std, shown = rig.rms_px, rig.std, OF_PAIR
            else:
                camera = solve_camera(whole[0], board, options)
                rms_px, std, shown = camera.rms_px, camera.covariance.std(), OF_LENS
            doubts = [
                Figure(name=f"± {words}", value=scale * std[name], unit=unit)
                for name, (words, scale, unit) in shown.items()
                if name in std
            ]
        return (Figure(name="residual, RMS", value=rms_px, unit="px"), *doubts)

    def _share(self, side: str) -> float:
        """Return the share of a camera's image that lies between all points, as its report tells it; 0 without any."""
        views = self._of(side)
        if not views:
            return 0.0
        return image_share(np.concatenate([view.uv_px for view in views]), views[0].width, views[0].height)

    def _bare_corner(self, side: str) -> tuple[int, int]:
        """Return the cell (column, row) of the corner that is farthest from all points."""
        views = self._of(side)
        uv = np.concatenate([view.uv_px for view in views]) / [views[0].width, views[0].height]
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        far = int(np.linalg.norm(uv[None] - corners[:, None], axis=2).min(axis=1).argmax())
        column, row = (CELLS - 1) * corners[far]
        return int(column), int(row)

    def _cells(self, side: str) -> NDArray[np.int64]:
        count = np.zeros((CELLS, CELLS), dtype=np.int64)
        for view in self._of(side):
            cell = (view.uv_px / [view.width, view.height] * CELLS).astype(int).clip(0, CELLS - 1)
            for column, row in {(int(c), int(r)) for c, r in cell}:
                count[row, column] += 1
        return count


OF_PAIR = {
    "left.fx": ("left focal length", 1.0, "px"),
    "right.fx": ("right focal length", 1.0, "px"),
    "baseline_m": ("baseline", 1e3, "mm"),
}
OF_LENS = {"fx": ("focal length", 1.0, "px"), "cx": ("principal point", 1.0, "px"), "k1": ("k1", 1.0, "")}
"""What is told of a standard deviation: words, factor, unit."""


def _doubts(found: ManySolved, names: tuple[str, ...]) -> list[Figure]:
    """Return the standard deviations of some cameras' lenses, and of their places but the first one's."""
    std = found.covariance.std()
    focal = [Figure(name=f"± {name} focal length", value=std[f"{name}.fx"], unit="px") for name in names]
    places = [1e3 * np.linalg.norm([std[f"{name}.{along}"] for along in PLACE[:3]]) for name in names[1:]]
    return focal + [
        Figure(name=f"± {name} place", value=float(mm), unit="mm") for name, mm in zip(names[1:], places, strict=True)
    ]


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
