"""The poses of a tracker's body as they come: one thread of the maker's library gives them, one other takes them."""

from __future__ import annotations

import queue
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import DeviceLost, DeviceNotFound, UsageError
from armsight.records import PoseStatus, TargetPose
from armsight.registry import TRACKERS, load

SILENT_S = 2.0
"""A tracker that sends nothing for so long is lost: the slowest send ten frames a second."""
MOST_WAITING = 1000
EXTRA = "Install it: pip install 'armsight[trackers]'"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackedBody:
    """A body at one moment: its pose in the tracker's axes, by the tracker's clock, and the frame's number."""

    pose: TargetPose
    sequence: int


class BodyStream(ABC):
    """A body of a tracker; opened and closed by `with`, its poses by iteration.

    A driver gives `_opened`, which begins the stream, `_closed`, and calls `put` from its own thread. std_m, std_rad:
    standard deviations of a pose, which no stream tells. Iteration raises DeviceLost where nothing comes any more.
    """

    def __init__(self, device: str, *, body: str, std_m: float, std_rad: float) -> None:
        self.name, self.body = device, body
        self._covariance = np.diag([std_m**2] * 3 + [std_rad**2] * 3)
        self._frames: queue.Queue[TrackedBody | str] = queue.Queue(MOST_WAITING)

    total, skew = None, None

    @abstractmethod
    def _opened(self) -> None:
        """Connect, choose the body, begin. Raises DeviceNotFound, UsageError."""

    @abstractmethod
    def _closed(self) -> None:
        """End it; legal at any time."""

    def __enter__(self) -> Self:
        try:
            self._opened()
        except BaseException:
            self._closed()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closed()

    def __iter__(self) -> Iterator[TrackedBody]:
        while True:
            try:
                frame = self._frames.get(timeout=SILENT_S)
            except queue.Empty:
                frame = f"nothing came for {SILENT_S:g} s"
            if isinstance(frame, str):
                raise DeviceLost(
                    f"the tracker {self.name} is lost: {frame}",
                    consequence="Nobody watches the arm any more",
                    cure="See that its program runs and streams in real time",
                )
            yield frame

    def chosen(self, names: Sequence[str]) -> int:
        """Return the number of the body asked for, or of the only one. Raises UsageError that lists those there."""
        among = [name for name in names if not self.body or name == self.body]
        if len(among) != 1:
            what = f"there is no body {self.body!r}" if self.body and not among else "it is open which body is meant"
            there = f"there are {', '.join(names)}" if names else "it has none"
            raise UsageError(
                f"{self.name}: {what}; {there}", cure="Give --body with the name of one, and names once each"
            )
        return list(names).index(among[0])

    def put(self, t_s: float, sequence: int, xyz_m: Array | None, R: Array | None, why: str = "") -> None:
        """Take a frame: position (3,) and rotation (3, 3), or None where the body is lost."""
        pose = TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig", why=why or "the tracker does not see the body")
        if xyz_m is not None and R is not None and np.isfinite(xyz_m).all() and np.isfinite(R).all() and R.any():
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = Rotation.from_matrix(R).as_matrix(), xyz_m
            pose = TargetPose(
                t_s=t_s, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=self._covariance
            )
        self._give(TrackedBody(pose=pose, sequence=sequence))

    def end(self, why: str) -> None:
        """Take that no more frames come, and why."""
        self._give(why)

    def _give(self, what: TrackedBody | str) -> None:
        while True:
            try:
                self._frames.put_nowait(what)
            except queue.Full:  # whoever takes them stands still: the oldest go
                self._frames.get_nowait()
            else:
                return


def open_tracker(text: str, *, body: str, std_m: float, std_rad: float) -> BodyStream:
    """Return the tracker that DRIVER:HOST[:PORT] names; nothing is opened yet. Raises UsageError, DeviceNotFound."""
    driver, colon, device = text.partition(":")
    if not colon or not device:
        raise UsageError(f"{text!r} names no tracker", cure="Write qtm:HOST or natnet:HOST")
    if not (np.isfinite([std_m, std_rad]).all() and std_m > 0.0 and std_rad > 0.0):
        raise UsageError("--tracker-std and --tracker-std-deg are standard deviations", cure="Give more than zero")
    made: BodyStream = load(TRACKERS, driver)(device, body=body, std_m=std_m, std_rad=std_rad)
    return made


def not_there(name: str) -> DeviceNotFound:
    """Return what is raised where a maker's public library is not installed."""
    return DeviceNotFound(
        f"the library {name} of trackers is not installed", consequence="Nothing was done", cure=EXTRA
    )


def host_and_port(device: str, default: int) -> tuple[str, int]:
    """Return HOST and PORT of HOST[:PORT]. Raises UsageError."""
    host, _, port = device.partition(":")
    if port and not (port.isdecimal() and 0 < int(port) < 65536):
        raise UsageError(f"the port {port!r} is none", cure="Write HOST or HOST:PORT")
    return host, int(port or default)
