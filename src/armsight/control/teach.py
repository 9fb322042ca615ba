"""The path of a tip while a target is led along it: every N-th frame's worth, at the exposure."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import NotEnoughData, StaleData, UsageError
from armsight.geometry import moved_parent_covariance
from armsight.kinematics import Arm
from armsight.records import PoseStatus, TargetPose, TaughtPath
from armsight.records.motion import JointHistory


class RigPose(Protocol):
    """Tells T_world_rig at a moment."""

    def __call__(self, t_s: float) -> RigidTransform:
        """Return T_world_rig at t_s. Raises StaleData where it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StandingRig:
    """A rig beside the robot, or without one."""

    T_world_rig: RigidTransform

    def __call__(self, t_s: float) -> RigidTransform:
        """Return T_world_rig, the same at any moment."""
        return self.T_world_rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarriedRig:
    """A rig on the flange of an arm whose readings come into history; T_flange_rig: by hand-eye calibration."""

    arm: Arm
    history: JointHistory
    T_flange_rig: RigidTransform

    def __call__(self, t_s: float) -> RigidTransform:
        """Return T_world_rig with the joints interpolated to t_s. Raises StaleData where they are not known there."""
        arm = self.arm
        T_world_tool = RigidTransform.from_matrix(arm.fk(arm.values(self.history.at(t_s).q)))
        return T_world_tool * arm.T_flange_tool.inv() * self.T_flange_rig


TAG = re.compile(r"[\w.-]{1,40}")


class Teaching(StrEnum):
    """What a recorder does with frames just now."""

    WAITING = "waiting"
    RECORDING = "recording"
    PAUSED = "paused"


@dataclass(frozen=True, slots=True, kw_only=True)
class TeachCounts:
    """Frames that came while recording, by what became of them.

    ok: their poses were taken. doubtful: whole poses not to be acted on. position_only, lost: without a whole pose.
    unplaced: where the rig was is not known.
    """

    ok: int = 0
    doubtful: int = 0
    position_only: int = 0
    lost: int = 0
    unplaced: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One vector: when, the target and the tip in world, the target's covariance (6, 6) and the position's tag."""

    t_s: float
    T_world_target: RigidTransform
    T_world_tip: RigidTransform
    covariance: Array
    tag: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """The target in world in one frame; covariance (6, 6): by the cameras alone, in world axes."""

    t_s: float
    T_world_target: RigidTransform
    covariance: Array


class PathRecorder:
    """Takes the poses of a target and keeps those of the tip. All methods may be called from any thread.

    A stretch begins with each start and ends with the pause after it. A frame without a whole pose is counted and
    never recorded, and no vector is averaged over it.
    """

    def __init__(
        self,
        rig_pose: RigPose,
        T_target_tip: RigidTransform,
        *,
        every: int = 1,
        mean: bool = False,
        parent: str = "world",
        notify: Callable[[str], None] = lambda _: None,
    ) -> None:
        """every: frames per vector. mean: the mean of these frames' poses and times, else the last one as it is.

        T_target_tip: the tip in target axes (tip.yaml). parent: the frame that rig_pose has the rig in, world or base.
        notify: called with what the recorder does, in words. Raises UsageError for less than one frame.
        """
        if every < 1:
            raise UsageError(f"one vector every {every} frames cannot be", cure="Give 1 or more (--every)")
        self._rig_pose, self._T_target_tip = rig_pose, T_target_tip
        self._every, self._mean = every, mean
        self.parent, self._notify = parent, notify
        self._lock = threading.Lock()
        self._state = Teaching.WAITING
        self._rows: list[_Row] = []
        self._begins: list[int] = []
        self._group: list[_Seen] = []
        self._tag = ""
        self._newest: RigidTransform | None = None
        self._last_s = -np.inf
        self._counts = dict.fromkeys(("ok", "doubtful", "position_only", "lost", "unplaced"), 0)

    @property
    def state(self) -> Teaching:
        """What it does with frames just now."""
        return self._state

    @property
    def counts(self) -> TeachCounts:
        """The frames that came while recording."""
        with self._lock:
            return TeachCounts(**self._counts)

    @property
    def tip(self) -> RigidTransform | None:
        """The newest T_world_tip, recorded or not; None before the first, or since the target was lost."""
        return self._newest

    @property
    def stretches(self) -> int:
        """How many stretches there are."""
        return len(self._begins)

    def __len__(self) -> int:
        return len(self._rows)

    def start(self) -> None:
        """Record from the next frame on; after a pause this begins a new stretch."""
        with self._lock:
            if self._state is not Teaching.RECORDING:
                self._begins.append(len(self._rows))
                self._group.clear()
                self._state = Teaching.RECORDING
                self._notify("recording")

    def pause(self) -> None:
        """Record nothing until the next start."""
        with self._lock:
            if self._state is Teaching.RECORDING:
                self._end_stretch()
                self._notify(f"paused after {len(self._rows)} poses")

    def undo(self) -> int:
        """Forget the last stretch and pause; return how many rows it had. Nothing happens where there is none."""
        with self._lock:
            self._group.clear()
            self._tag = ""
            if not self._begins:
                return 0
            begin = self._begins.pop()
            forgotten = len(self._rows) - begin
            del self._rows[begin:]
            self._state = Teaching.PAUSED if self._begins else Teaching.WAITING
            self._notify(f"the last {forgotten} poses forgotten")
            return forgotten

    def forget_since(self, t_s: float) -> None:
        """Pause, and forget all rows later than t_s: what was seen since turned out to be wrong."""
        with self._lock:
            self._group.clear()
            kept = [row for row in self._rows if row.t_s <= t_s]
            forgotten = len(self._rows) - len(kept)
            self._rows, self._begins = kept, [begin for begin in self._begins if begin < len(kept)]
            self._state = Teaching.PAUSED if self._begins else Teaching.WAITING
            self._notify(f"the {forgotten} poses since a camera was wrong are forgotten")

    def tag(self, word: str) -> None:
        """Mark where the tip is: the next row, or the stretch's last. Raises UsageError for more than one word."""
        if not TAG.fullmatch(word):
            raise UsageError(f"the tag {word[:40]!r} is not one word")
        with self._lock:
            self._tag = word
            self._notify(f"tag {word}")

    def observe(self, pose: TargetPose, exposed_s: float) -> None:
        """Take what a frame shows, in rig axes, exposed at exposed_s on the clock of the position."""
        with self._lock:
            found, seen = self._seen_in(pose, exposed_s)
            self._newest = None if seen is None else seen.T_world_target * self._T_target_tip
            if self._state is not Teaching.RECORDING:
                return
            self._counts[found] += 1
            if seen is None or exposed_s <= self._last_s:
                self._group.clear()
                return
            self._last_s = exposed_s
            self._group.append(seen)
            if len(self._group) >= self._every:
                self._rows.append(self._row())
                self._group.clear()

    def path(self, *, speed_m_s: float = np.nan) -> TaughtPath:
        """Return what was taught so far, at one speed all along. Raises NotEnoughData below two rows."""
        with self._lock:
            rows = list(self._rows)
            last = self._tag if self._state is Teaching.RECORDING else ""
        if len(rows) < 2:
            raise NotEnoughData(
                f"{len(rows)} poses were taught, which are no path",
                consequence="Nothing is kept",
                cure="Start recording, and lead the whole target along where the cameras see it",
            )
        tags = [row.tag for row in rows]
        tags[-1] = tags[-1] or last
        return TaughtPath(
            T_world_tip=np.array([row.T_world_tip.as_matrix() for row in rows]),
            t_s=np.array([row.t_s for row in rows]),
            speed_m_s=np.full(len(rows), speed_m_s),
            tags=tuple(tags),
            parent=self.parent,
        )

    def targets(self) -> tuple[TargetPose, ...]:
        """Return the target's pose of each row, in the frame of the path, as sure as the cameras alone are of it.

        The covariance of a mean is that of one of its frames: what repeats from frame to frame does not average out.
        """
        with self._lock:
            return tuple(
                TargetPose(
                    t_s=row.t_s,
                    status=PoseStatus.OK,
                    parent=self.parent,
                    T_parent_target=row.T_world_target.as_matrix(),
                    covariance=row.covariance,
                )
                for row in self._rows
            )

    def _seen_in(self, pose: TargetPose, exposed_s: float) -> tuple[str, _Seen | None]:
        """Return what the frame counts as, and where the target was in world where that is known."""
        if pose.status is not PoseStatus.OK or pose.T_parent_target is None or pose.covariance is None:
            return pose.status.value, None
        try:
            T_world_rig = self._rig_pose(exposed_s)
        except StaleData:
            return "unplaced", None
        covariance = moved_parent_covariance(T_world_rig, pose.covariance)
        return "ok", _Seen(exposed_s, T_world_rig * RigidTransform.from_matrix(pose.T_parent_target), covariance)

    def _row(self) -> _Row:
        last = self._group[-1]
        t_s, T, covariance = last.t_s, last.T_world_target, last.covariance
        if self._mean and len(self._group) > 1:
            t_s = float(np.mean([seen.t_s for seen in self._group]))
            T = RigidTransform.from_matrix(np.array([seen.T_world_target.as_matrix() for seen in self._group])).mean()
            covariance = np.mean([seen.covariance for seen in self._group], axis=0)
        tag, self._tag = self._tag, ""
        return _Row(t_s, T, T * self._T_target_tip, covariance, tag)

    def _end_stretch(self) -> None:
        """Close the stretch; one without rows is none, and a tag that no row took is its last one's."""
        self._group.clear()
        begin = self._begins[-1]
        if len(self._rows) == begin:
            self._begins.pop()
        elif self._tag and not self._rows[-1].tag:
            self._rows[-1] = replace(self._rows[-1], tag=self._tag)
            self._tag = ""
        self._state = Teaching.PAUSED
