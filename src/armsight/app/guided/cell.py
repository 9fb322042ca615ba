"""A whole cell from one recording of the moving arm: guided, and calibrated as `armsight calibrate cell` does."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight._files import real_path
from armsight.app.guided.cell_recorder import FRAMES, LOG, CellRecorder, CellWatch, ReadJoints
from armsight.app.guided.step import Hint, Next, Sample, StepResult
from armsight.app.live.measurement import DetectionSettings
from armsight.app.live.station import MeasurementProcess
from armsight.calibrate.cell import CellResult
from armsight.calibrate.handeye import Setup
from armsight.clock import Clock, SystemClock
from armsight.errors import ArmsightError, NotEnoughData, UsageError
from armsight.file_names import ARM, HANDEYE, REPORT, RIG, TARGET, WORLD
from armsight.kinematics import Arm
from armsight.ops.arm_files import load_arm
from armsight.ops.calibrate_cell import calibrate_cell
from armsight.ops.measurement.run import target_of
from armsight.optics import SIDES
from armsight.records import Progress
from armsight.store.handeye_file import write_handeye_poses
from armsight.units import DEG, MM, displayed

PREFIX = "cell-"
"""Of the folder of a recording and its result, before the time of its beginning."""
LEAST_S, WANTED_S = 20.0, 60.0
"""Seconds of motion without which nothing is calibrated, and from which most of a cell is told."""
TURN, SLIDE = 20.0 * DEG, 0.05
"""Over how much every joint should move."""
FILES = {"target": "the target, target.yaml", "arm": "the arm, arm.yaml"}
AT_ORIGIN = 1e-9
"""By which entries of a base's place may differ from the origin's."""


@dataclass(slots=True, kw_only=True)
class CellStep:
    """folder: of the cell; every recording has a folder of its own in it, which takes its result as well.

    file_of: the file of a key of the cell as it is now, None where it has none. read_joints: of the robot that is
    connected; None where `log`, a file of the same motion, is brought afterwards. sides: the cameras.
    look: how lights are looked for.
    """

    folder: Path
    file_of: Callable[[str], Path | None]
    read_joints: ReadJoints | None
    sides: tuple[str, ...] = SIDES
    look: Callable[[], DetectionSettings] = DetectionSettings
    clock: Clock = field(default_factory=SystemClock)
    name: str = "cell"
    log: Path | None = None
    recorder: CellRecorder | None = None
    _arm: Arm | None = None

    @property
    def recording(self) -> bool:
        """Whether it records."""
        return self.recorder is not None and self.recorder.running

    @property
    def watch(self) -> CellWatch:
        """What the recording holds so far."""
        return CellWatch(sides=self.sides) if self.recorder is None else self.recorder.watch

    @property
    def samples(self) -> tuple[Sample, ...]:
        """The recording, once it has ended."""
        if self.recorder is None or self.recording:
            return ()
        watch = self.recorder.watch
        joints = f", {len(watch.readings)} readings of the joints" if watch.readings else ""
        detail = f"{watch.seconds:.0f} s{joints}"
        if self.recorder.failure:
            detail = f"{detail}. {self.recorder.failure}"
        return (Sample(name=self.recorder.folder.name, detail=detail, used=not self.recorder.failure),)

    def hint(self) -> Hint:
        """Return what is missing most: lights, a joint's motion, a part of a picture, time; then the log."""
        watch = self.watch
        if not self.recording:
            if watch.seconds < LEAST_S:
                return Hint(what=Next.RECORD_CELL)
            return Hint(what=Next.RUN if self._log() is not None else Next.BRING_LOG)
        if watch.lost_side:
            return Hint(what=Next.LIGHTS_BACK, side=watch.lost_side)
        moved = [(now / wanted, name) for name, now, wanted, _ in self._joints()]
        if moved and min(moved)[0] < 1.0:
            share, name = min(moved)
            return Hint(what=Next.MOVE_JOINT, axis=name, share=share)
        if watch.seconds >= WANTED_S:
            return Hint(what=Next.END_RECORDING)
        for side, cells in watch.cells.items():
            if cells.min() == 0:
                row, column = np.unravel_index(int(np.argmin(cells)), cells.shape)
                return Hint(what=Next.TO_PLACE, side=side, cell=(int(column), int(row)))
        return Hint(what=Next.GO_ON)

    def coverage(self) -> dict[str, tuple[int, ...]]:
        """Return per camera in how many pictures a moving light was seen in each cell."""
        return {side: tuple(cells.ravel().tolist()) for side, cells in self.watch.cells.items()}

    def spread(self) -> tuple[tuple[str, str], ...]:
        """Return how much there is of what is wanted: time, range of each joint, pictures with all lights."""
        watch = self.watch
        rows = [("recorded", f"{watch.seconds:.0f} of {WANTED_S:.0f} s, {LEAST_S:.0f} at least")]
        for name, now, wanted, slides in self._joints():
            unit, factor = displayed("m" if slides else "rad")
            rows.append((f"joint {name}", f"{now / factor:.0f} of {wanted / factor:.0f} {unit}"))
        if watch.n_pictures:
            rows += [
                (f"All lights seen, {side}", f"{watch.seen_share(side):.0%} of the pictures") for side in self.sides
            ]
        return tuple(rows)

    def _joints(self) -> Iterator[tuple[str, float, float, bool]]:
        """Yield name, range so far, range wanted of each joint, and whether it slides."""
        ranges, arm = self.watch.ranges, self._arm
        for j, now in enumerate(ranges.tolist()):
            known = arm is not None and arm.n == len(ranges)
            slides = arm is not None and known and not arm.revolute[j]
            name = arm.joints[j].name if arm is not None and known else f"{j + 1}"
            yield name, now, SLIDE if slides else TURN, slides

    def _read(self) -> int:
        """Read the arm, for the names of its joints; return how many lights the target has, 0 where none is known.

        What is missing or wrong the page tells before; a recording needs neither.
        """
        self._arm = None
        with suppress(ArmsightError):
            arm = self.file_of("arm")
            self._arm = None if arm is None else load_arm(str(arm))
        with suppress(ArmsightError):
            file = self.file_of("target")
            target = None if file is None else target_of(file)
            return 0 if target is None or target.is_board else len(target.names)
        return 0

    def begin(self, station: MeasurementProcess) -> None:
        """Begin a recording; one that runs goes on. Raises UsageError, DeviceFailed."""
        if self.recording:
            return
        folder = self._new_folder()
        made = CellRecorder(station, folder, self.read_joints, self.clock, n_lights=self._read(), sides=self.sides)
        made.begin()
        self.recorder, self.log = made, None

    def _new_folder(self) -> Path:
        begun = time.strftime(f"{PREFIX}%Y%m%d-%H%M%S")
        names = [begun, *(f"{begun}-{n}" for n in range(2, 100))]
        return next(self.folder / name for name in names if not (self.folder / name).exists())

    def end(self) -> None:
        """End the recording, if one runs. Raises NotEnoughData where nothing came of it."""
        if self.recorder is None:
            return
        self.recorder.end()
        if self.recorder.failure:
            raise NotEnoughData(
                self.recorder.failure,
                consequence=f"{self.watch.seconds:.0f} s were recorded until then",
                cure="Drop it and record anew, unless that is enough",
            )

    def accept(self, station: MeasurementProcess) -> Sample:
        """Begin the recording; called again, end it. Raises as these do."""
        if self.recording:
            self.end()
            return self.samples[0]
        self.begin(station)
        return Sample(name=self.require_recorder().folder.name, detail="recording")

    def drop(self, index: int) -> None:
        """Forget the recording and its files; a result that the cell measures with stays."""
        if self.recorder is None or self.recording:
            return
        folder = self.recorder.folder
        if self._used():
            for name in (FRAMES, LOG):
                (folder / name).unlink(missing_ok=True)
        else:
            shutil.rmtree(folder, ignore_errors=True)
        self.recorder = self.log = None

    def require_recorder(self) -> CellRecorder:
        """Return what was recorded. Raises NotEnoughData where nothing was, or it goes on."""
        if self.recorder is None or self.recording:
            raise NotEnoughData(
                "the recording goes on" if self.recording else "nothing was recorded",
                consequence="Nothing was calibrated",
                cure="End it first" if self.recording else "Record the moving arm first",
            )
        return self.recorder

    def _log(self) -> Path | None:
        """Return the joints' log: of the robot that is connected, or the one that was brought."""
        if self.log is not None:
            return self.log
        return self.recorder.folder / LOG if self.recorder is not None and self.watch.readings else None

    def run(self, progress: Progress) -> StepResult:
        """Calibrate; the files are written beside the recording. Raises as calibrate_cell."""
        recorder = self.require_recorder()
        if self.watch.seconds < LEAST_S:
            raise NotEnoughData(
                f"{self.watch.seconds:.0f} s were recorded",
                consequence="A cell is not calibrated from so little",
                cure=f"Record {LEAST_S:.0f} s of motion at least, better one to two minutes",
            )
        if used := self._used():
            raise UsageError(
                f"the cell's {used} is the result of this recording",
                consequence="Nothing was calibrated: what the recording tells would count twice",
                cure="Record anew",
            )
        look, tip, log = self.look(), self.file_of("tip"), self._log()
        if log is None:
            raise NotEnoughData(
                "the arm's log of this motion is missing",
                consequence="Nothing was calibrated",
                cure="Bring the controller's log (t_s,q1,... in rad) into the cell's folder, and name it",
            )
        done = calibrate_cell(
            robot_log=log,
            target=self._needed("target"),
            model=self._needed("arm"),
            out=recorder.folder,
            cameras=dict.fromkeys(self.sides, str(recorder.folder / FRAMES)),
            tip=tip,
            threshold=look.threshold,
            inverted=look.inverted,
            progress=progress,
        )
        return _verdict(done, recorder.folder)

    def _needed(self, key: str) -> Path:
        file = self.file_of(key)
        if file is None:
            raise NotEnoughData(
                f"the cell has no {FILES[key]}", consequence="Nothing was calibrated", cure="See the page Settings"
            )
        return file

    def _used(self) -> str:
        """Return the key of the cell's file that is this recording's own result, empty where none is."""
        own = real_path(self.require_recorder().folder)
        for key in ("rig", "world", "target", "arm", "handeye"):
            with suppress(ArmsightError):
                file = self.file_of(key)
                if file is not None and real_path(file).parent == own:
                    return key
        return ""


def _verdict(done: CellResult, folder: Path) -> StepResult:
    """Write where cameras and target are on the robot as the hand-eye calibration says it, and return the verdict."""
    write_handeye_poses(folder / HANDEYE, Setup.EYE_TO_HAND, done.T_base_rig, done.T_flange_target)
    lists = [("What was learned", tuple(_learned(done)))]
    lists += [("What it cannot tell", (*done.gauges, *_held(done)))]
    if done.notes or done.advice:
        lists.insert(0, ("What to know, and to do", (*done.notes, *done.advice)))
    return StepResult(
        verdict=done.verdict_,
        rows=tuple(_rows(done)),
        file=folder / RIG,
        report=folder / REPORT,
        lists=tuple(lists),
        use=tuple((key, folder / name if name else None) for key, name in used_files(done.arm.T_world_base).items()),
    )


def used_files(T_world_base: RigidTransform) -> dict[str, str]:
    """Return under which keys of the cell which files of the result stand.

    Without world where the arm's base is not the world's origin: the console takes the station's poses, which are in
    base axes then, for ones in the world. Hand-eye and arm tell it there.
    """
    used = {"rig": RIG, "world": WORLD, "target": TARGET, "arm": ARM, "handeye": HANDEYE}
    if np.abs(T_world_base.as_matrix() - np.eye(4)).max() > AT_ORIGIN:
        used["world"] = ""
    return used


def _rows(done: CellResult) -> Iterator[tuple[str, str]]:
    tip, scale = done.tip, done.scale
    for name, typical, worst in (
        (f"tip, as {done.all_cameras} measure it", tip.measured_m, tip.measured_worst_m),
        ("tip, as the arm's joints say", tip.commanded_m, tip.commanded_worst_m),
    ):
        yield name, f"± {typical / MM:.2g} mm (1 σ), ± {worst / MM:.2g} mm at worst"
    yield "added by the noise of one pair", f"± {tip.noise_m / MM:.2g} mm"
    yield "scale", f"{scale.ratio:.4f} ± {scale.std:.4f}, the target by the arm's lengths; the {scale.set_by} sets it"
    if done.baseline_m is not None and done.baseline_std_m is not None:
        yield "baseline", f"{done.baseline_m / MM:.1f} ± {done.baseline_std_m / MM:.2g} mm"
    yield "residual, RMS", f"{', '.join(f'{name} {px:.3f}' for name, px in done.residual_px.items())} px"
    yield "seen", f"{done.duration_s:.0f} s of motion, {done.n_frames} frames, {done.n_spots} spots"


def _learned(done: CellResult) -> Iterator[str]:
    """Yield for each part of the cell how much was learned of it."""
    # by how its name begins
    parts = {f"{name}.": f"{name} camera" for name in done.rig.names} | {"light:": "lights", "": "arm"}
    for start, part in parts.items():
        own = [one for one in done.learned if one.name.startswith(start)]
        if not start:
            own = [one for one in done.learned if not one.name.startswith(tuple(filter(None, parts)))]
        if not own:
            continue
        bits = [one.bits for one in own if one.bits is not None]
        known = f", known {2.0 ** float(np.median(bits)):.3g} times as well as before" if bits else ""
        nothing = [one.name for one in own if one.name in done.unlearned]
        yield f"{part}: {len(own)} figures{known}" + (f"; nothing new of {', '.join(nothing)}" if nothing else "")


def _held(done: CellResult) -> Iterator[str]:
    if done.fixed:
        yield f"Held as in the arm's file: {', '.join(done.fixed)}"
