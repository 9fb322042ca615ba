"""What all pages of one console share."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from armsight.app.guided.boards import BoardCalibration
from armsight.app.guided.cell import CellStep
from armsight.app.guided.mirror_alignment import MirrorAlignment
from armsight.app.guided.mirrors import MirrorsStep
from armsight.app.guided.poses import ArmStep, HandEyeStep, TipCalibrationStep
from armsight.app.guided.step import Guided
from armsight.app.guided.step_runner import GuidedStepRunner
from armsight.app.guided.timing import TimingStep
from armsight.app.live.measurement import DetectionSettings, FollowedCell, LiveJob, require_kind
from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.app.live.views import LiveView
from armsight.app.operator.path_editor import PathEditor
from armsight.app.operator.robot_cell import RobotCell, simulated_cameras
from armsight.app.operator.supervise import StationSupervisor
from armsight.app.operator.teach_controller import TeachController
from armsight.arrays import Array
from armsight.calibrate.handeye import Setup
from armsight.clock import SystemClock
from armsight.console.plots import Tracks
from armsight.drivers import is_live
from armsight.errors import ArmsightError, NotEnoughData, UsageError
from armsight.ops.measurement.run import target_of
from armsight.ops.sources.cameras import cameras_of, named_cameras
from armsight.optics import SIDES, RigKind
from armsight.store import read_rig, read_world
from armsight.store.cell_file import COMPLEX, CellFile, CellMirrors, cell_path, read_cell, write_cell
from armsight.verify.supervision import Seen

HISTORY = 1800
"""Moments kept for the curves: a minute at 30 a second."""


def values_of(view: LiveView) -> Array:
    """Return x, y, z in m and rx, ry, rz in rad (6,), NaN where not known."""
    none = (np.nan,) * 3
    return np.array([*(view.xyz_m or none), *(view.euler_rad or none)])


@dataclass(slots=True, kw_only=True)
class Console:
    """A cell in a folder, its measuring station, and how it looks for lights."""

    folder: Path
    cell: CellFile = field(default_factory=CellFile)
    station: MeasurementProcess | None = None
    look: DetectionSettings = field(default_factory=DetectionSettings)
    last_recording: Path | None = None
    history: deque[Array] = field(default_factory=lambda: deque(maxlen=HISTORY))
    """(7,) each: t_s, then as values_of."""
    tracks: Tracks = field(default_factory=Tracks)
    _newest: LiveView | None = None
    steps: dict[str, GuidedStepRunner] = field(default_factory=dict)
    _alignment: MirrorAlignment | None = None
    robot: RobotCell | None = None
    supervisor: StationSupervisor | None = None
    _teaching: TeachController | None = None
    _path: PathEditor | None = None
    refusal: str = ""
    """Why the cell as it was kept is not measured."""

    @classmethod
    def of_folder(cls, folder: Path, robot: RobotCell | None = None) -> Console:
        """Return the console of a folder's cell, not measuring yet. Raises BadFile."""
        return cls(folder=folder, cell=read_cell(folder), robot=robot)

    def begin(self, changed: Mapping[str, Any], *, robot: str | None = None) -> str:
        """Measure the cell as it was kept, with entries of its file changed; return why not where it cannot be.

        What was kept and went wrong since is for the page Settings to mend; what was given just now is refused.
        Raises as apply for changed entries.
        """
        kept = self.cell if robot is None else self.cell.model_copy(update={"robot": robot})
        try:
            self.apply(kept.changed(changed))
        except ArmsightError as error:
            if changed:
                raise
            self.refusal = str(error)
        return self.refusal

    def seen(self) -> Seen | None:
        """Return what a supervision that goes on measured last, for the plant's systems; any thread may call this."""
        supervisor = self.supervisor
        return None if supervisor is None else supervisor.seen

    def note(self, message: str) -> None:
        """Keep what happened in the robot's log where there is one, else in the program's; any thread may call this."""
        if self.robot is None:
            logging.getLogger("armsight.console").warning(message)
        else:
            self.robot.service.authority.note("warning", message)

    def apply(self, cell: CellFile) -> None:
        """Check what a cell names, keep it in cell.yaml, and measure with it. Raises UsageError, DataRefused."""
        job = self.job_of(cell)
        write_cell(self.folder, cell)
        self.cell = cell
        self.refusal = ""
        self.close()
        self.look = DetectionSettings()
        self._forget_steps()
        if job is not None:
            self.station = MeasurementProcess(job, tell=self.note)
            self.station.start()

    def job_of(self, cell: CellFile) -> LiveJob | None:
        """Return what is measured, None without cameras; every file is read, so that a wrong one is refused here."""
        rig, target, world = (cell_path(self.folder, getattr(cell, name), name) for name in ("rig", "target", "world"))
        known_rig = None if rig is None else read_rig(rig, any_cameras=True)
        if target is not None:
            target_of(target)
        if world is not None:
            read_world(world)
        if cell.right and not cell.left and not cell.named:
            raise UsageError("the left camera is missing", cure="Give both, or none; the one camera of mirrors as left")
        sources = cell.sources
        if not sources:
            return None
        if COMPLEX not in sources or COMPLEX in cell.named:
            sources = named_cameras(cell.named, cell.left or None, cell.right or None)
        if known_rig is not None and known_rig.kind is not RigKind.MIRROR and COMPLEX not in sources:
            sources = cameras_of(known_rig.names, sources)
            if len(sources) > len(cell.sources):
                raise UsageError("one recording is of all cameras", cure="Give it for each of them by its name")
        job = LiveJob(
            cameras=sources,
            rig=rig,
            target=target,
            world=world,
            fps=None if any(map(is_live, sources.values())) else cell.fps,
            again=cell.play_again,
            followed=self._followed(cell),
        )
        require_kind(job, known_rig)
        return job

    @property
    def pictures(self) -> tuple[str, ...]:
        """Which pictures there are: of the cameras by name, or the complex one of one camera with mirrors."""
        return tuple(self.cell.sources) or SIDES

    def _followed(self, cell: CellFile) -> FollowedCell | None:
        """Return the simulated cell whose robot is moved here, where the cameras named are its own."""
        followed = None if self.robot is None else self.robot.followed
        own = followed is not None and cell.sources == simulated_cameras(followed.scenario)
        return followed if own else None

    def teaching(self) -> TeachController:
        """Return the recorder of paths, begun where there is none. Raises NotEnoughData, BadFile."""
        if self._teaching is None:
            self._teaching = TeachController(
                self.folder, self.cell, self.require_robot(), lambda: self.station, SystemClock()
            )
        return self._teaching

    def path_editor(self) -> PathEditor:
        """Return the path of the cell. Raises BadFile."""
        if self._path is None:
            self._path = PathEditor(self.folder)
        return self._path

    def require_robot(self) -> RobotCell:
        """Return the robot. Raises NotEnoughData where none is connected."""
        if self.robot is None:
            raise NotEnoughData(
                "no robot is connected", consequence="Nothing can be moved", cure="Start with --robot DRIVER:DEVICE"
            )
        return self.robot

    def step(self, name: str) -> GuidedStepRunner:
        """Return a guided calibration, begun anew where it was not under way. Raises UsageError, BadFile."""
        if name not in self.steps:
            self.steps[name] = GuidedStepRunner(_maker(self, name)(self, self.folder / "calibrate" / name))
        return self.steps[name]

    def set_mirrors(self, built: CellMirrors) -> None:
        """Keep how the mirrors were built in cell.yaml; the step begins anew. Raises DeviceFailed."""
        self.cell = self.cell.model_copy(update={"mirrors": built})
        write_cell(self.folder, self.cell)
        self._forget_steps("mirrors")

    def mirror_alignment(self) -> MirrorAlignment:
        """Return the live check of the mirrors, held against the cell's rig where that is a mirror rig.

        Raises BadFile.
        """
        if self._alignment is None:
            self._alignment = MirrorAlignment(
                board=self.cell.board,
                built=self.cell.mirrors,
                folder=self.folder / "calibrate" / "mirrors",
                rig=self.mirror_rig(),
                camera=cell_path(self.folder, self.cell.camera, "camera"),
            )
        return self._alignment

    def mirror_rig(self) -> Path | None:
        """Return the cell's rig.yaml where it is a mirror rig's. Raises BadFile."""
        rig = cell_path(self.folder, self.cell.rig, "rig")
        return rig if rig is not None and read_rig(rig, any_cameras=True).kind is RigKind.MIRROR else None

    def _forget_steps(self, *names: str) -> None:
        """Begin steps anew; where none is named all but one that reads the cell's files when it needs them."""
        for name in names or tuple(self.steps):
            if name != CELL:
                self.steps.pop(name, None)
        self._alignment = None

    def set_look(self, look: DetectionSettings) -> None:
        """Look for lights in another way, on the screen and in the station."""
        self.look = look
        if self.station is not None:
            self.station.look(look)

    def record(self) -> Path | None:
        """Begin a recording named after the time, or end the one that runs; return the file begun."""
        if self.station is None:
            return None
        if self.station.recording.file is not None:
            self.last_recording = self.station.recording.file
            self.station.record(None)
            return None
        file = self.folder / f"recording-{datetime.now():%Y%m%d-%H%M%S}.mcap"
        self.station.record(file)
        return file

    def remember(self) -> Snapshot | None:
        """Return the newest moment; its pose is kept for the curves."""
        shown = self.station.shown if self.station is not None else None
        if shown is not None and self._newest is not shown.view:
            self._newest = shown.view
            self.history.append(np.append(shown.view.t_s, values_of(shown.view)))
        return shown

    @property
    def current(self) -> bool:
        """Whether the newest moment is how it is now."""
        return self.station is not None and self.station.current

    def close(self) -> None:
        """End measuring, and teaching, supervision and a cell's recording with it."""
        cell = self.steps.get(CELL)
        if cell is not None and isinstance(cell.step, CellStep):
            with suppress(ArmsightError):
                cell.step.end()
        if self.supervisor is not None:
            with suppress(ArmsightError):
                self.supervisor.end()
        self.supervisor = None
        if self._teaching is not None:
            self._teaching.close()
        self._teaching = None
        if self.station is not None:
            self.station.stop()
        self.station = None
        self.history.clear()
        self.tracks.clear()

    def require_station(self) -> MeasurementProcess:
        """Return the measuring station. Raises UsageError where there is none."""
        if self.station is None:
            raise UsageError("no cameras are set up", cure="Give both cameras on the page Settings")
        return self.station

    def file(self, name: str) -> Path:
        """Return a file of the cell by its key. Raises NotEnoughData where the cell has none yet."""
        path = cell_path(self.folder, getattr(self.cell, name), name)
        if path is None:
            raise NotEnoughData(
                f"the cell has no {name} yet", consequence="This step cannot begin", cure="See the page Settings"
            )
        return path


def _rig(console: Console, folder: Path) -> Guided:
    out = console.folder / "rig.yaml"
    return BoardCalibration(board=console.cell.board, folder=folder, out=out, sides=console.pictures)


def _lens(picture: str, console: Console, folder: Path) -> Guided:
    out = console.folder / f"{folder.name}.yaml"
    return BoardCalibration(board=console.cell.board, folder=folder, out=out, sides=(picture,))


def _mirrors(console: Console, folder: Path) -> Guided:
    there = tuple(console.cell.sources)
    if there != (COMPLEX,):
        raise UsageError(
            "mirrors stand before one camera, and this cell has "
            + (f"the cameras {', '.join(there)}" if there else "no camera yet"),
            consequence="This step cannot begin",
            cure="Give the one camera as the left one on the page Settings, and leave the right one empty",
        )
    cell = console.cell
    return MirrorsStep(
        board=cell.board,
        built=cell.mirrors,
        folder=folder,
        out=console.folder / "rig.yaml",
        target=cell_path(console.folder, cell.target, "target"),
        camera=cell_path(console.folder, cell.camera, "camera"),
    )


def _timing(console: Console, folder: Path) -> Guided:
    rig = console.file("rig")
    target, sides = console.file("target"), console.pictures
    return TimingStep(rig=rig, target=target, folder=folder, out=rig, sides=sides)


def _tip(console: Console, folder: Path) -> Guided:
    return TipCalibrationStep(folder=folder, out=console.folder / "tip.yaml")


def _handeye(console: Console, folder: Path) -> Guided:
    return HandEyeStep(
        folder=folder,
        out=console.folder / "handeye-calibrated.yaml",
        arm=console.file("arm"),
        setup=Setup.EYE_IN_HAND if console.cell.on_robot else Setup.EYE_TO_HAND,
        read_joints=console.require_robot().reading,
    )


def _arm(console: Console, folder: Path) -> Guided:
    return ArmStep(
        folder=folder,
        out=console.folder / "arm-calibrated.yaml",
        model=str(console.file("arm")),
        read_joints=console.require_robot().reading,
    )


def _whole_cell(console: Console, folder: Path) -> Guided:
    """Return the step of the page Cell, which keeps its recordings in folders of their own."""
    return CellStep(
        folder=console.folder,
        file_of=lambda name: cell_path(console.folder, getattr(console.cell, name), name),
        read_joints=None if console.robot is None else console.robot.reading,
        sides=console.pictures,
        look=lambda: console.look,
    )


CELL = "cell"
"""The step that has a page of its own."""

OF_RIG: dict[str, Callable[[Console, Path], Guided]] = {
    "stereo": _rig,
    "cameras": _rig,
    "mirrors": _mirrors,
    "timing": _timing,
    "tooltip": _tip,
    "handeye": _handeye,
    "arm": _arm,
    CELL: _whole_cell,
}
"""Steps of a whole cell; before them stand those of its cameras' lenses."""
LENS = "camera-"
"""Begins the name of a lens's step, before that of its camera; the one of mirrors is called left."""


def lenses_of(console: Console) -> dict[str, str]:
    """Return the picture of each lens's step."""
    return {f"{LENS}{SIDES[0] if name == COMPLEX else name}": name for name in console.pictures}


def _maker(console: Console, name: str) -> Callable[[Console, Path], Guided]:
    lens = lenses_of(console).get(name)
    return OF_RIG[name] if lens is None else partial(_lens, lens)


def steps_of(console: Console) -> tuple[str, ...]:
    """Return the steps that the page Calibrate offers for a cell, in their order."""
    known = {SIDES: ("stereo", "mirrors", "timing"), (COMPLEX,): ("mirrors",)}
    of_rig = known.get(console.pictures, ("cameras", "timing") if len(console.pictures) > 1 else ())
    return (*lenses_of(console), *of_rig, "tooltip", "handeye", "arm")
