"""HAL: the bridge's pins, the sampler as clock, the streamer, and what LinuxCNC does just now."""

from __future__ import annotations

import contextlib
import sys
from typing import Any

MAY, ENABLED, HOMED, JOINT_MODE, E_STOP, AUTO, MDI = (1 << i for i in range(7))
SWITCH_ON, HOME, OFFSETS, READS = 1, 2, 4, 8


class Pins:
    """HAL as the bridge uses it, for n joints."""

    OUT = (
        "heartbeat",
        "session",
        "jog-enable",
        "estop-reset",
        "machine-off",
        "machine-on",
        "manual",
        "joint-mode",
        "world-mode",
        "home-all",
        "offsets",
        "pause",
        "inhibit",
        "free",
    )
    IN = ("enabled", "homed", "teleop", "coord", "estop", "auto", "mdi", "running", "ok")
    """Pins of its own: asking HAL for those of others waits for a lock, which any halcmd may hold for 0.1 s."""

    def __init__(self, n: int, offsets: int) -> None:
        """offsets: how many axes have external offsets here; their counts are behind the joints'."""
        sys.path.append("/usr/lib/python3/dist-packages")
        import hal  # type: ignore[import-not-found]

        self._n, self._component = n, hal.component("armsight")
        for names, way in ((self.OUT, hal.HAL_OUT), (self.IN, hal.HAL_IN)):
            for name in names:
                self._component.newpin(name, hal.HAL_BIT, way)
        self._component.ready()
        self.signals = set()
        for name in self.OUT + self.IN:  # a bridge that is started again joins the signals that its predecessor had
            with contextlib.suppress(Exception):  # that of a line that was left out
                hal.connect(f"armsight.{name}", f"armsight-{name}")
                self.signals.add(name)
        for name in self.OUT:
            self._component[name] = name == "free"
        self.counts = [int(hal.get_value(f"streamer.0.pin.{j}")) for j in range(n + offsets)]
        self._samples = hal.stream(self._component, hal.sampler_base)
        self._counts = hal.stream(self._component, hal.streamer_base)

    def sample(self) -> tuple[int, list[float], list[float], list[float]] | None:
        """Return the newest sample's number, commanded and measured positions, offsets; None: none has come."""
        newest = None
        while self._samples.readable:
            row = self._samples.read()
            if row is None:
                break
            newest = (
                self._samples.sampleno,
                list(row[: self._n]),
                list(row[self._n : 2 * self._n]),
                list(row[2 * self._n :]),
            )
        return newest

    @property
    def waiting(self) -> int:
        """How many samples wait for the streamer."""
        return int(self._counts.depth)

    def feed(self, rows: list[tuple[int, ...]]) -> None:
        """Let the streamer have counts; `counts` are the last ones that it was given."""
        for row in rows:
            if self._counts.write(row) is not False:
                self.counts = list(row)

    def get(self, name: str) -> bool:
        """Return a pin of the bridge."""
        return bool(self._component[name])

    def put(self, name: str, value: bool) -> None:
        """Set a pin of the bridge."""
        self._component[name] = value

    def flags(self, offsets: bool) -> int:
        """Return what LinuxCNC does just now, and whether it takes what is sent: jogs of joints, or offsets."""
        told = (
            (ENABLED, self.get("enabled")),
            (HOMED, self.get("homed")),
            (JOINT_MODE, not (self.get("teleop") or self.get("coord"))),
            (E_STOP, self.get("estop")),
            (AUTO, self.get("auto")),
            (MDI, self.get("mdi")),
        )
        return allowed(sum(bit for bit, on in told if on), offsets)


def allowed(flags: int, offsets: bool) -> int:
    """Return what LinuxCNC does with the bit MAY where it takes offsets, or jogs of joints, meanwhile."""
    needed = ENABLED | HOMED
    watched = needed | JOINT_MODE if offsets else needed | JOINT_MODE | AUTO | MDI
    return flags | MAY * (flags & watched == needed | (0 if offsets else JOINT_MODE))


class Switching:
    """Ends the e-stop, switches on, homes and chooses joint mode, where that was asked for: once, at the opening."""

    WAIT_S, PULSE_S = 10.0, 0.1

    def __init__(self, what: int, now_s: float) -> None:
        self._what, self._begun_s, self._next_s = what, now_s, now_s
        self._pin = self._last = ""

    def turn(self, pins: Any, flags: int, now_s: float) -> None:
        """Do what is next."""
        if flags & MAY or now_s - self._begun_s > self.WAIT_S:
            self._what = 0  # an e-stop that comes later stays
        if now_s < self._next_s:
            return
        self._next_s = now_s + self.PULSE_S
        if self._pin:
            pins.put(self._pin, False)
            self._pin = ""
            return
        self._pin = self._due(flags)
        if self._pin == "machine-on" and self._last != "machine-off":
            self._pin = "machine-off"  # motion that was ended by motion.enable is on already by the task's own state
        if self._pin:
            self._last = self._pin
            pins.put(self._pin, True)

    def _due(self, flags: int) -> str:
        """Return the pin that is next; home comes before joint mode, since all joints' homing ends in teleop mode."""
        wanted = (
            (SWITCH_ON, flags & E_STOP, "estop-reset"),
            (SWITCH_ON, not flags & ENABLED, "machine-on"),
            (SWITCH_ON | HOME, flags & (AUTO | MDI) and not self._what & OFFSETS, "manual"),
            (HOME, not flags & HOMED, "home-all"),
            (SWITCH_ON | HOME, not (flags & JOINT_MODE or self._what & OFFSETS), "joint-mode"),
            (SWITCH_ON | HOME, flags & JOINT_MODE and self._what & OFFSETS, "world-mode"),
        )
        return next((pin for what, missing, pin in wanted if self._what & what and missing), "")
