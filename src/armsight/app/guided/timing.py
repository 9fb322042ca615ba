"""When free-running cameras expose, from a recording of the moving target."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armsight.app.guided.step import Hint, Next, Sample, StepResult
from armsight.app.live.station import MeasurementProcess
from armsight.errors import NotEnoughData
from armsight.ops.calibrate_rig import calibrate_timing
from armsight.ops.calibration.spots_of_frames import LIVE_S
from armsight.optics import SIDES
from armsight.records import Progress


@dataclass(slots=True, kw_only=True)
class TimingStep:
    """rig, target, sides, the cameras: of the cell. folder: takes the recording. out: rig.yaml with its timing."""

    rig: Path
    target: Path
    folder: Path
    out: Path
    sides: tuple[str, ...] = SIDES
    name: str = "timing"
    _recording: Path | None = None
    _pairs: int = 0
    _seconds: float = 0.0

    @property
    def samples(self) -> tuple[Sample, ...]:
        """The recording, once there is one."""
        if self._recording is None:
            return ()
        return (
            Sample(name=self._recording.name, detail=f"{self._pairs} pictures of each camera, {self._seconds:.0f} s"),
        )

    def hint(self) -> Hint:
        """Return whether to record, or to calibrate."""
        return Hint(what=Next.RECORD if self._seconds < LIVE_S else Next.RUN)

    def coverage(self) -> dict[str, tuple[int, ...]]:
        """Nothing."""
        return {}

    def spread(self) -> tuple[tuple[str, str], ...]:
        """Return how much was recorded of what is wanted."""
        return (("recorded", f"{self._seconds:.0f} of {LIVE_S:.0f} s"),)

    def accept(self, station: MeasurementProcess) -> Sample:
        """Begin the recording; called again, end it. Raises NotEnoughData where nothing is in it."""
        state = station.recording
        if state.file is None:
            file = self.folder / "timing.mcap"
            file.unlink(missing_ok=True)
            station.record(file)
            self._recording, self._seconds = file, 0.0
            return Sample(name=file.name, detail="recording")
        fps = station.shown.view.fps if station.shown is not None else 0.0
        self._pairs, self._seconds = state.n_pairs, state.n_pairs / fps if fps else 0.0
        station.record(None)
        return self.samples[0]

    def drop(self, index: int) -> None:
        """Forget the recording."""
        if self._recording is not None:
            self._recording.unlink(missing_ok=True)
        self._recording, self._pairs, self._seconds = None, 0, 0.0

    def run(self, progress: Progress) -> StepResult:
        """Calibrate and write rig.yaml anew with the timing."""
        if self._recording is None:
            raise NotEnoughData("nothing was recorded", consequence="Nothing was calibrated", cure="Record first")
        text = str(self._recording)
        cameras = {name: f"{text}:{name}" for name in self.sides}
        done = calibrate_timing(self.rig, self.target, cameras=cameras, out=self.out, progress=progress)
        rows = []
        for name in self.sides[1:]:
            own, of = done.clocks[name], "" if self.sides == SIDES else f", {name}"
            rows += [
                (f"delay{of}", f"{1e3 * own.delay_s:.2f} ms"),
                (f"± in the middle{of}", f"{1e3 * own.std_middle_s:.3f} ms (1 σ)"),
                (f"drift{of}", f"{own.drift_ppm:.1f} ppm"),
            ]
        return StepResult(verdict=done.verdict_, rows=tuple(rows), file=self.out)
