"""What all pages of one console share."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from armsight.app.live.measurement import LiveJob, Look
from armsight.app.live.station import Shown, Station

HISTORY = 1800
"""Moments kept for the curves: a minute at 30 a second."""


@dataclass(slots=True, kw_only=True)
class Console:
    """The measuring station, how it looks for lights, and the folder that everything is written into."""

    folder: Path
    station: Station | None = None
    look: Look = field(default_factory=Look)
    last_recording: Path | None = None
    history: deque[Shown] = field(default_factory=lambda: deque(maxlen=HISTORY))

    def watch(self, job: LiveJob) -> None:
        """Measure with these cameras from now on."""
        self.close()
        self.look = Look()
        self.station = Station(job)
        self.station.start()

    def set_look(self, look: Look) -> None:
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

    def remember(self) -> Shown | None:
        """Return the newest moment, kept for the curves."""
        shown = self.station.shown if self.station is not None else None
        if shown is not None and (not self.history or self.history[-1] is not shown):
            self.history.append(shown)
        return shown

    def close(self) -> None:
        """End measuring."""
        if self.station is not None:
            self.station.stop()
        self.station = None
        self.history.clear()
