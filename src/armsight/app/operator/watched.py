"""A path played from the page, watched by the station that measures for it."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from scipy.spatial.transform import RigidTransform

from armsight.app.live.station import Shown, Station
from armsight.app.measure.outputs import moved_pose
from armsight.app.operator.placing import rig_pose
from armsight.app.operator.teach import seen as pose_of_view
from armsight.app.play.job import load_sight
from armsight.app.play.target_monitor import Seen
from armsight.clock import Clock
from armsight.control.events import QueueSink
from armsight.errors import ArmsightError, DeviceFailed
from armsight.kinematics import Arm
from armsight.records import PoseStatus, TargetPose
from armsight.store.cell_file import CellFile, cell_path

LOOK_S = 0.004
SILENT_S = 2.0
"""A station that shows nothing new for so long does not watch any more."""


class StationWatcher:
    """The measuring station as what watches a path: its poses, brought back into the rig's axes."""

    stepped = False

    def __init__(self, station: Station, handeye: Path, T_rig_parent: RigidTransform, clock: Clock) -> None:
        """T_rig_parent: of the frame that the station's poses are in, seen from the rig. Raises BadFile."""
        self.sight = load_sight(handeye)
        self._station, self._T_rig_parent, self._clock = station, T_rig_parent, clock
        self._counts = dict.fromkeys(PoseStatus, 0)
        self._ended = threading.Event()
        self._failed: ArmsightError | None = None

    def open(self, stack: ExitStack, sink: QueueSink, seen: Seen) -> None:
        """Tell what the station shows until stack ends."""
        thread = threading.Thread(target=self._watch, args=(sink, seen), name="watching", daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(self._ended.set)

    def counts(self) -> Mapping[PoseStatus, int]:
        """Return the moments so far by what they showed."""
        return dict(self._counts)

    def failed(self) -> ArmsightError | None:
        """Return why nothing is watched any more."""
        return self._failed

    def _watch(self, sink: QueueSink, seen: Seen) -> None:
        last: Shown | None = None
        newest_s = self._clock.now_s()
        while not self._ended.wait(LOOK_S):
            shown, now_s = self._station.shown, self._clock.now_s()
            if self._station.failure or now_s - newest_s > SILENT_S:
                why = self._station.failure or "no pictures come any more"
                self._failed = DeviceFailed(
                    f"{why} while the path was played",
                    consequence="The robot is held: nobody watched it",
                    cure="Look at the cameras, then play again",
                )
                return
            if shown is None or shown is last:
                continue
            last, newest_s = shown, now_s
            pose = self._in_rig(pose_of_view(shown.view))
            exposed_s = shown.view.t_s  # monotonic time is one for all processes of a machine
            self._counts[pose.status] += 1
            seen(pose, exposed_s)
            sink.pose(replace(pose, t_s=exposed_s))

    def _in_rig(self, pose: TargetPose) -> TargetPose:
        if pose.T_parent_target is None:
            return pose
        return moved_pose(pose, self._T_rig_parent, "rig")


def watcher_of(
    folder: Path, cell: CellFile, arm: Arm | None, station: Station | None, clock: Clock
) -> StationWatcher | None:
    """Return what watches the cell's robot; None without cameras, or where their place on it is not known.

    Raises BadFile.
    """
    handeye = cell_path(folder, cell.handeye, "handeye")
    if station is None or handeye is None or station.job.rig is None:
        return None
    T_world_rig = rig_pose(folder, cell, arm, None) if cell.world else RigidTransform.identity()
    return None if T_world_rig is None else StationWatcher(station, handeye, T_world_rig.inv(), clock)
