"""What measures where the target is while an arm is supervised: cameras of a rig, or a tracker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cameras.pairing import turns_of
from armsight.drivers import Views, by_name
from armsight.drivers.trackers.source import TrackedBody
from armsight.measure.consistency.findings import LeftOut
from armsight.measure.consistency.live_cameras import WatchedTracker
from armsight.measure.poses.pipeline import Setup
from armsight.records import Frame, TargetPose
from armsight.store.recording import RecordingWriter


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighted:
    """What was measured at a moment: the pose, its number, the newest exposure of it, and frames, for the recording."""

    pose: TargetPose
    sequence: int
    newest_s: float
    frames: Mapping[str, Frame] = field(default_factory=dict)


class Eyes(Protocol):
    """What measures the moments of a source. of_pair: it is two cameras. turns: see PredictedPose."""

    turns: Array

    @property
    def of_pair(self) -> bool:
        """Whether its moments are pairs of frames."""

    @property
    def contradictions(self) -> Sequence[LeftOut]:
        """What is wrong, so far."""

    def attach(self, writer: RecordingWriter) -> None:
        """Write what the poses are measured by into a recording that begins."""

    def take(self, moment: Any) -> Sighted:
        """Measure a moment."""


class CameraEyes:
    """Cameras of a rig that see lights. files: rig.yaml and target.yaml; frames: the images are kept."""

    def __init__(self, setup: Setup, files: Sequence[Path], *, frames: bool) -> None:
        self._rig, self._tracker = setup.rig, WatchedTracker(setup)
        self._files, self._frames, self.of_pair = files, frames, setup.rig.is_pair
        self.turns = turns_of(setup.target)

    @property
    def contradictions(self) -> Sequence[LeftOut]:
        """What is wrong with the rig, so far."""
        return self._tracker.contradictions

    def attach(self, writer: RecordingWriter) -> None:
        """Write rig and target."""
        for name, path in zip(("rig.yaml", "target.yaml"), self._files, strict=True):
            if path.exists():
                writer.attach(name, path.read_bytes())
        writer.rig(0.0, self._rig)

    def take(self, moment: Views) -> Sighted:
        """Measure by the cameras that agree."""
        frames = by_name(self._rig.names, moment)
        return Sighted(
            pose=self._tracker.take(*moment).pose,
            sequence=next(iter(frames.values())).sequence,
            newest_s=max(frame.t_s for frame in frames.values()),
            frames=frames if self._frames else {},
        )


class TrackerEyes:
    """A tracker that measures by itself."""

    contradictions: Sequence[LeftOut] = ()
    of_pair, turns = False, np.eye(4)[None]

    def attach(self, writer: RecordingWriter) -> None:
        """Write nothing: poses say all."""

    def take(self, moment: TrackedBody) -> Sighted:
        """Return the pose as it came."""
        return Sighted(pose=moment.pose, sequence=moment.sequence, newest_s=moment.pose.t_s)
