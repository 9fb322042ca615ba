"""Live cameras, read in threads of their own."""

from __future__ import annotations

import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

import cv2
import numpy as np

from armsight._files import DeviceLock, is_utf8
from armsight.clock import Clock, SystemClock
from armsight.drivers import camera_settings
from armsight.drivers.usb import crowd_of
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound
from armsight.records import Frame

DEPTH = 4
"""Frames a live camera keeps for a slow reader; older ones are dropped, since a late frame is worth less."""

FAILED_READS = 3
"""Reads that may fail one after the other before a camera counts as lost: USB cameras drop single frames."""

SILENCE_S = 3.0
"""No frame for so long means that the camera is lost; webcams take up to 2 s to deliver their first one."""

SETTLED = 30
"""Frames after which locked settings are looked at again: some cameras take to their automatics once frames flow."""


def open_camera(device: str) -> camera_settings.CameraCapture:
    """Open a camera by number or device file with OpenCV. Raises DeviceNotFound for a name that it crashes at."""
    if not is_utf8(device):
        raise DeviceNotFound(f"there is no camera {device}: its name is not UTF-8", cure="Give its number, or its file")
    capture: camera_settings.CameraCapture = cv2.VideoCapture(int(device) if device.isdecimal() else device)
    return capture


def cameras_there() -> tuple[str, ...]:
    """Return the cameras that the system knows, as they are named on the command line."""
    devices = sorted(Path("/dev").glob("video*"), key=lambda path: (len(path.name), path.name))
    return tuple(f"camera:{path.name.removeprefix('video')}" for path in devices)


class LiveCamera(ABC):
    """What every live camera shares: a lock, a thread of its own from opening on, the newest DEPTH frames kept.

    A driver opens its device in _open_device, reads it in _read_frames until _stop is set, handing out what comes with
    _put, and closes it in _close_device. One process at a time may read it (DeviceFailed for a second one).
    waits: silence is no failure, because a trigger decides when frames come. cure: what to do where it is lost.
    n_late: frames since it was opened that newer ones displaced before they were asked for.
    """

    waits = False
    cure = "Check the plug and the cable, and start again"

    def __init__(self, name: str, *, clock: Clock | None, origin_s: float | None, lock: DeviceLock | None) -> None:
        self.name = name
        self._lock = lock
        self._clock = clock or SystemClock()
        self._origin_s = origin_s
        self._thread: threading.Thread | None = None
        self.n_late = 0
        self._stop = threading.Event()
        self._frames: queue.Queue[Frame | DeviceFailed] = queue.Queue(maxsize=DEPTH)

    @property
    def total(self) -> int | None:
        """None: it goes on until stopped."""
        return None

    @abstractmethod
    def _open_device(self) -> None:
        """Open it, or leave nothing open and raise DeviceFailed."""

    @abstractmethod
    def _read_frames(self) -> None:
        """Put frames until _stop is set; in a thread. A DeviceFailed it raises reaches the reader in its turn."""

    @abstractmethod
    def _close_device(self) -> None:
        """Close it; called only once its thread has ended."""

    def __enter__(self) -> Self:
        if self._lock is not None:
            self._lock.__enter__()
        try:
            self._open_device()
        except BaseException:
            self._unlock()
            raise
        self._origin_s = self._clock.now_s() if self._origin_s is None else self._origin_s
        self._stop.clear()
        self.n_late = 0
        self._frames = queue.Queue(maxsize=DEPTH)
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=SILENCE_S)
            if not self._thread.is_alive():
                self._close_device()  # closing under a thread that hangs in the driver would crash
        self._thread = None
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.__exit__(None, None, None)

    def __iter__(self) -> Iterator[Frame]:
        while not self._stop.is_set():
            try:
                frame = self._frames.get(timeout=SILENCE_S)
            except queue.Empty:
                if self.waits:
                    continue
                raise self._lost(f"sent no frame for {SILENCE_S:g} s") from None
            if isinstance(frame, DeviceFailed):
                raise frame
            yield frame

    def _run(self) -> None:
        try:
            self._read_frames()
        except DeviceFailed as error:
            self._put(error)

    def _now_s(self) -> float:
        return self._clock.now_s() - (self._origin_s or 0.0)

    def _put(self, item: Frame | DeviceFailed) -> None:
        while True:
            try:
                self._frames.put_nowait(item)
                return
            except queue.Full:
                try:
                    self._frames.get_nowait()
                except queue.Empty:
                    continue
                self.n_late += 1

    def _lost(self, what: str) -> DeviceLost:
        return DeviceLost(
            f"{self.name} {what}", consequence="No frame is measured from here on; those before stay", cure=self.cure
        )


class OpenCvCamera(LiveCamera):
    """A camera that OpenCV can open, by number (0, 1 ...) or device file.

    t_s is the moment of arrival on the clock minus origin_s (default: the moment of opening); what the driver
    holds back before that is not known. settings are locked on opening and looked at again after SETTLED frames:
    DeviceFailed where the camera does otherwise. clock, and open_capture with the lock, can be replaced for tests.
    """

    def __init__(
        self,
        device: str,
        *,
        colour: bool = False,
        clock: Clock | None = None,
        origin_s: float | None = None,
        settings: camera_settings.CameraSettings = camera_settings.AUTOMATIC,
        open_capture: Callable[[str], camera_settings.CameraCapture] = open_camera,
        lock: DeviceLock | None = None,
    ) -> None:
        name = f"camera:{device}"
        settings.require_only(camera_settings.SETTINGS, name)
        own = DeviceLock(name) if lock is None and open_capture is open_camera else lock
        super().__init__(name, clock=clock, origin_s=origin_s, lock=own)
        self._device = device
        self._colour = colour
        self._settings = settings
        self._open_capture = open_capture
        self._capture: camera_settings.CameraCapture | None = None
        self._started = False

    def _open_device(self) -> None:
        capture = self._open_capture(self._device)
        if not capture.isOpened():
            capture.release()
            there = ", ".join(cameras_there())
            raise DeviceNotFound(
                f"{self.name} cannot be opened",
                consequence="There are no frames",
                cure=f"Cameras there: {there}. Another program may hold it" if there else "No camera is connected",
            )
        try:
            camera_settings.lock_settings(capture, self._settings, self.name, self._clock)
        except BaseException:
            capture.release()
            raise
        self._capture = capture

    def _close_device(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _read_frames(self) -> None:
        capture = self._capture
        sequence, failed = 0, 0
        while capture is not None and not self._stop.is_set():
            try:
                good, image = capture.read()
            except cv2.error:
                good, image = False, None
            t_s = self._now_s()
            if good and image is not None:
                self._put(Frame(image=self._convert(image), t_s=t_s, sequence=sequence, source=self.name))
                sequence, failed, self._started = sequence + 1, 0, True
                if sequence == SETTLED:
                    camera_settings.check_settings(capture, self._settings, self.name)
                continue
            failed += 1
            if failed >= FAILED_READS:
                raise self._lost(f"stopped sending after {sequence} frames")

    def _lost(self, what: str) -> DeviceLost:
        lost = super()._lost(what)
        lost.cure = ("" if self._started else crowd_of(self._device)) or lost.cure
        return lost

    def _convert(self, image: np.ndarray) -> np.ndarray:
        if image.ndim == 3 and not self._colour:
            return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        return image
