"""The mirrors of a one-camera rig from a board, or the lit target, that a person shows: as `calibrate mirrors` does."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.app.guided.boards import CELLS, ENOUGH, FEWEST, TILTED, TILTED_SHARE, tilt
from armsight.app.guided.step import Figure, Hint, Next, Sample, StepResult
from armsight.app.live.station import MeasurementProcess
from armsight.calibrate.cameras import BoardOptions
from armsight.calibrate.cameras.preconditions import image_share
from armsight.calibrate.mirrors.calibration import MirrorCalibration, calibrate_mirrors
from armsight.calibrate.mirrors.diagnosis import LEAST_LIT, mirrors_from_target
from armsight.calibrate.mirrors.result import MirrorsOutput
from armsight.drivers import read_image
from armsight.errors import ArmsightError, BadImage, DataRefused, NotEnoughData, UsageError
from armsight.file_names import report_path
from armsight.ops.calibrate_mirrors import calibrate_mirrors as calibrate_from_images
from armsight.ops.calibration.board_images import see_two_boards
from armsight.ops.calibration.board_pictures import BoardPictures
from armsight.ops.calibration.mirrors import CURES, OTHER_CURE, lit_design
from armsight.ops.calibration.mirrors_lit_target import CURES as LIT_CURES
from armsight.ops.calibration.mirrors_lit_target import OTHER_CURE as OTHER_LIT_CURE
from armsight.ops.calibration.mirrors_lit_target import see_lights
from armsight.optics import Rig
from armsight.optics.parallelism import parallelism
from armsight.records import BoardView, Frame, NotSeen, Progress, Target, TargetPose
from armsight.store import parse_board, read_camera, read_target
from armsight.store.cell_file import COMPLEX, CellMirrors

ENOUGH_LIT = 15
IMAGES = "image"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Taken:
    """One complex image: its name, the left and the right view, and of lights the pose."""

    name: str
    pair: tuple[BoardView, BoardView]
    pose: TargetPose | None = None


@dataclass(slots=True, kw_only=True)
class MirrorsStep:
    """Complex images, one after the other, for rig.yaml.

    board: what is shown, or target with camera (the lens), as built.shown says. folder: takes the pictures. out:
    rig.yaml.
    """

    board: str
    built: CellMirrors
    folder: Path
    out: Path
    target: Path | None = None
    camera: Path | None = None
    name: str = "mirrors"
    _views: list[_Taken] = field(default_factory=list)
    _count: int = 0
    _solved: tuple[tuple[str, ...], MirrorCalibration | str] | None = None

    @property
    def lit(self) -> bool:
        """Whether the lit target is shown, not a board."""
        return self.built.shown == "target"

    @property
    def samples(self) -> tuple[Sample, ...]:
        """The complex images accepted so far."""
        out = []
        for one in self._views:
            left, right = one.pair
            apart = float(np.mean(left.uv_px[:, 0]) - np.mean(right.uv_px[:, 0]))
            kind = "lights" if self.lit else "points"
            out.append(Sample(name=one.name, detail=f"{len(left)} {kind} in each view, {apart:.0f} px apart"))
        return tuple(out)

    def _designed(self) -> tuple[Rig, Target]:
        """Return the rig as it was designed, its lens known, and the lit target. Raises UsageError, BadFile."""
        if self.target is None:
            raise UsageError("the cell has no target", cure="Give the lit target on the page Settings")
        camera = None if self.camera is None else read_camera(self.camera)
        return lit_design(self.built, camera, image=True), read_target(self.target)

    def coverage(self) -> dict[str, tuple[int, ...]]:
        """Return how many samples lie in each cell of the one picture, in either view: both are of one lens."""
        return {COMPLEX: tuple(self._cells().ravel().tolist())}

    def hint(self) -> Hint:
        """Return what is missing most."""
        if self.lit:
            needs = {
                Next.NEEDS_TARGET: self.target,
                Next.NEEDS_LENS: self.camera,
                Next.NEEDS_BASELINE: self.built.baseline_m,
            }
            for what, there in needs.items():
                if there is None:
                    return Hint(what=what)
            n = len(self._views)
            return Hint(what=Next.SHOW_LIGHTS if n == 0 else Next.RUN if n >= ENOUGH_LIT else Next.TURN_LIGHTS)
        if not self._views:
            return Hint(what=Next.BOARD_TWICE)
        cells = self._cells()
        if cells.min() == 0:
            row, column = np.unravel_index(int(np.argmin(cells)), cells.shape)
            return Hint(what=Next.TO_CELL, side=COMPLEX, cell=(int(column), int(row)))
        if len(self._views) >= ENOUGH:  # a small board far away shows its tilt less: the deviations tell by then
            return Hint(what=Next.RUN)
        board = parse_board(self.board)
        tilted = np.mean([tilt(one.pair[0], board) > TILTED for one in self._views])
        return Hint(what=Next.TILT if tilted < TILTED_SHARE else Next.MORE)

    def spread(self) -> tuple[tuple[str, str], ...]:
        """Return what the images so far tell of the mirrors, with standard deviations."""
        solved = self._solve()
        if not isinstance(solved, MirrorCalibration):
            return (("", solved),) if solved else ()
        baseline, std_m = solved.rig.baseline_m, solved.pair.baseline_std_m
        rows = [("baseline", f"{1e3 * baseline:.2f} ± {1e3 * std_m:.2g} mm")]
        now = parallelism(solved.pair.rig)
        std = now.std or {}
        for name, words, scale, unit in (
            ("convergence_rad", "axes turn towards each other", 1e3, "mrad"),
            ("vertical_px", "right view lower", 1.0, "px"),
            ("roll_rad", "right view turned", 1e3, "mrad"),
        ):
            sure = f" ± {scale * std[name]:.2g}" if name in std else ""
            rows.append((words, f"{scale * getattr(now, name):+.2f}{sure} {unit}"))
        if solved.seen_m is not None and solved.seen_std_m is not None:
            rows.append(("glass plate", f"{1e3 * solved.seen_m:.2f} ± {1e3 * solved.seen_std_m:.2g} mm"))
        return tuple(rows)

    def figures(self) -> tuple[Figure, ...]:
        """Return residual and standard deviations, for a plot against the number of images."""
        solved = self._solve()
        if not isinstance(solved, MirrorCalibration):
            return ()
        out = [
            Figure(name="residual, RMS", value=solved.pair.rms_px, unit="px"),
            Figure(name="± baseline", value=1e3 * solved.pair.baseline_std_m, unit="mm"),
        ]
        std = parallelism(solved.pair.rig).std or {}
        if "convergence_rad" in std:
            out.append(Figure(name="± convergence", value=1e3 * std["convergence_rad"], unit="mrad"))
        uv = np.concatenate([view.uv_px for one in self._views for view in one.pair])
        covered = image_share(uv, self._views[0].pair[0].width, self._views[0].pair[0].height)
        return (*out, Figure(name="picture covered", value=100.0 * covered, unit="%"))

    def accept(self, station: MeasurementProcess) -> Sample:
        """Take the picture of now. Raises UsageError for two cameras, BadImage where it does not show both views."""
        if not station.job.complex:
            raise UsageError(
                "the cell has two cameras, and mirrors stand before one",
                consequence="No picture was taken",
                cure="Give the one camera as the left one on the page Settings, and leave the right one empty",
            )
        if not self._views:
            self._clear()
        name = f"{self._count:03d}"
        file = self.folder / IMAGES / f"{name}.png"
        station.save({COMPLEX: file})
        frame = Frame(
            image=read_image(file, colour=self._colour()),
            t_s=float(self._count),
            sequence=self._count,
            source=file.name,
        )
        try:
            taken = self._seen(name, frame)
        except ArmsightError:
            file.unlink(missing_ok=True)
            raise
        self._count += 1
        self._views.append(taken)
        return self.samples[-1]

    def drop(self, index: int) -> None:
        """Forget an image."""
        taken = self._views.pop(index)
        (self.folder / IMAGES / f"{taken.name}.png").unlink(missing_ok=True)

    def run(self, progress: Progress) -> StepResult:
        """Calibrate from the accepted images as the command does; write rig.yaml and its report."""
        fewest = LEAST_LIT if self.lit else FEWEST
        if len(self._views) < fewest:
            raise NotEnoughData(
                f"{len(self._views)} images were accepted",
                consequence="Nothing was calibrated",
                cure=f"Accept {fewest} at least, better {ENOUGH_LIT if self.lit else ENOUGH}",
            )
        built = self.built
        shown = {"target": self.target, "camera": self.camera} if self.lit else {"board": self.board}
        done = calibrate_from_images(
            str(self.folder / IMAGES),
            **shown,
            thickness_m=built.plate_m,
            index=built.index,
            baseline_m=built.baseline_m,
            near_m=built.near_m,
            gap_m=built.gap_m,
            out=self.out,
            progress=progress,
        )
        return self._verdict(done)

    def _verdict(self, done: MirrorsOutput) -> StepResult:
        std_m, left_out = done.std["baseline_m"], done.holdout_rms_px
        now = done.alignment
        rows = (
            ("images used", f"{done.n_used} of {done.n_pairs}"),
            ("RMS", f"{done.rms_px:.3f} px"),
            ("RMS of boards left out", "–" if left_out is None else f"{left_out:.3f} px"),
            ("baseline", f"{1e3 * done.baseline_m:.2f} ± {1e3 * std_m:.2g} mm (1 σ)"),
            ("axes turn towards each other", f"{1e3 * now.convergence_rad:+.2f} mrad"),
            ("right view lower", f"{now.vertical_px:+.2f} px"),
            ("right view turned", f"{1e3 * now.roll_rad:+.2f} mrad"),
            ("one lens explains both views", "yes" if done.one_lens else "no"),
        )
        return StepResult(verdict=done.verdict_, rows=rows, file=self.out, report=report_path(self.out))

    def _seen(self, name: str, frame: Frame) -> _Taken:
        """Return what an image shows. Raises BadImage with what helps."""
        if self.lit:
            return self._lights(name, frame)
        seen = see_two_boards(frame, parse_board(self.board), BoardPictures())
        if isinstance(seen, NotSeen):
            raise BadImage(seen.why, consequence="The picture was not taken", cure=CURES.get(seen.cause, OTHER_CURE))
        return _Taken(name=name, pair=seen)

    def _lights(self, name: str, frame: Frame) -> _Taken:
        design, target = self._designed()
        found = see_lights(design, target, frame)
        if not found.views:
            seen = found.rejected[0][1]
            raise BadImage(
                seen.why, consequence="The picture was not taken", cure=LIT_CURES.get(seen.cause, OTHER_LIT_CURE)
            )
        return _Taken(name=name, pair=found.views[0], pose=found.poses[0])

    def _colour(self) -> bool:
        return self.lit and self.target is not None and read_target(self.target).colour is not None

    def _clear(self) -> None:
        """Take away what an earlier calibration left, so that only what was accepted counts."""
        for file in (self.folder / IMAGES).glob("*.png"):
            file.unlink()

    def _cells(self) -> NDArray[np.int64]:
        count = np.zeros((CELLS, CELLS), dtype=np.int64)
        for one in self._views:
            size = [one.pair[0].width, one.pair[0].height]
            uv = np.concatenate([view.uv_px for view in one.pair])
            cell = (uv / size * CELLS).astype(int).clip(0, CELLS - 1)
            for column, row in {(int(c), int(r)) for c, r in cell}:
                count[row, column] += 1
        return count

    def _solve(self) -> MirrorCalibration | str:
        """Return the calibration of the images so far; why there is none in words, empty for too few."""
        names = tuple(one.name for one in self._views)
        if len(names) < (LEAST_LIT if self.lit else FEWEST):
            return ""
        if self._solved is None or self._solved[0] != names:
            try:
                self._solved = names, self._calibrated()
            except DataRefused as error:
                self._solved = names, str(error.cause)
        return self._solved[1]

    def _calibrated(self) -> MirrorCalibration:
        left, right = [one.pair[0] for one in self._views], [one.pair[1] for one in self._views]
        if not self.lit:
            options = BoardOptions(folds=0)
            board, plate_m = parse_board(self.board), self.built.plate_m
            return calibrate_mirrors(left, right, board, thickness_m=plate_m, index=self.built.index, options=options)
        design, target = self._designed()
        poses = [one.pose for one in self._views if one.pose is not None]
        return mirrors_from_target(design, list(zip(left, right, strict=True)), poses, target)
