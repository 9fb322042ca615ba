"""Frames of a rig's cameras at one time each, put together by their stamps: of live cameras, recordings, videos."""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from statistics import median

from armsight.drivers.moments import PAIR, Moment, Moments, ended_early
from armsight.drivers.protocols import FrameSource
from armsight.errors import DeviceFailed, Inconsistent
from armsight.records import Frame
from armsight.records.result_parts import Skew

MAX_SKEW_S = 1.0 / 60.0
"""Half a frame at 30 a second: free-running cameras always have a partner within it."""

UNPAIRED_LIMIT = 60
"""Frames dropped one after the other for want of a partner before pairing is given up."""

INTERVALS = 31
"""Frames whose distances in time say how long a period of a camera is: a second of a webcam."""

APART_S = 3e-3
"""Time between two frames of a moment (RMS of a second) from which their cameras seem to run freely: stamps of
triggered webcams jitter by a millisecond or two."""

AFTER = 3
"""Moments of the others after which a camera that sends no more has ended before them."""


class _Period:
    """How far apart the frames of a camera come, by their own stamps and numbers; infinite before the second one."""

    def __init__(self) -> None:
        self._last: Frame | None = None
        self._each_s: deque[float] = deque(maxlen=INTERVALS)
        self.s, self.until_s = math.inf, 0.0

    def see(self, frame: Frame | None) -> Frame | None:
        """Take the next frame, and hand it on; frames that a slow reader missed are in its number."""
        if frame is not None and self._last is not None and frame.sequence > self._last.sequence:
            self._each_s.append((frame.t_s - self._last.t_s) / (frame.sequence - self._last.sequence))
            self.s = median(self._each_s)
        self._last = frame
        self.until_s = self.until_s if frame is None else frame.t_s
        return frame


class TimedMoments(Moments):
    """Frames put together by time stamp, no further than max_skew_s and half a period of theirs apart.

    Further apart, another frame is nearer: after one lost frame all later pairs would be of neighbours. The oldest of
    frames too far apart is dropped. Raises DeviceLost where a camera goes, DeviceFailed where the cameras' frames never
    meet. short: the source of a pair that ended while the other went on for two frames and more.
    """

    def __init__(
        self,
        *sources: FrameSource,
        names: Sequence[str] = PAIR,
        max_skew_s: float = MAX_SKEW_S,
        fewest: int | None = None,
        tell: Callable[[str], None] = warnings.warn,
    ) -> None:
        super().__init__(*sources, names=names, fewest=fewest, tell=tell)
        self._max_skew_s = max_skew_s
        self._spread_s2: list[float] = []
        self._sum_s = self._largest_s = 0.0
        self._n = 0
        self.short: FrameSource | None = None

    @property
    def skew(self) -> Skew | None:
        """Of a pair right minus left so far, of more the last frame minus the first; None before the first moment."""
        if not self._n:
            return None
        return Skew(mean_s=self._sum_s / self._n, largest_s=self._largest_s, n_pairs=self._n, n_dropped=self.n_dropped)

    def _moments(self, streams: Sequence[Iterator[Frame]]) -> Iterator[Moment]:
        n, self._streams = len(self.sources), streams
        self._periods = [_Period() for _ in self.sources]
        self._heads: list[Frame | None] = [self._next(k) for k in range(n)]
        self._missed, self._ended = [0] * n, [0] * n
        while near := self._near():
            self._count([frame.t_s for k, frame in self._there().items() if k in near])
            yield Moment(frame if k in near else None for k, frame in enumerate(self._heads))
            self._step(near)
        if n == len(PAIR) and (self._heads[0] is None) != (self._heads[1] is None):
            short = 0 if self._heads[0] is None else 1
            if next(self._streams[1 - short], None) is not None:
                self.short = self.sources[short]

    def _there(self) -> dict[int, Frame]:
        return {k: frame for k, frame in enumerate(self._heads) if frame is not None}

    def _near(self) -> list[int]:
        """Return whose next frames are a moment, after those that are of none are dropped; none at the end."""
        dropped = 0
        while len(there := self._there()) >= self.fewest:
            first = min(there, key=lambda k: there[k].t_s)
            limit = min(self._max_skew_s, *(0.5 * self._periods[k].s for k in there))
            near = [k for k in there if there[k].t_s - there[first].t_s <= limit]
            if len(near) >= self.fewest:
                return near
            dropped += 1
            self.n_dropped += 1
            if dropped >= UNPAIRED_LIMIT:
                raise self._never_meet(there)
            self._heads[first] = self._next(first)
        return []

    def _step(self, near: Sequence[int]) -> None:
        """Take the next frames of those that had one in a moment, and leave out who has ended or never has."""
        there = self._there()
        since = min(there[k].t_s for k in near)
        for k, frame in there.items():
            self._missed[k] = 0 if k in near else self._missed[k] + 1
            if k in near:
                self._heads[k] = self._next(k)
            elif self._missed[k] >= UNPAIRED_LIMIT:
                self._heads[k] = None
                self._lose(k, self._apart(k, frame.t_s - since))
        for k, head in enumerate(self._heads):
            self._ended[k] += head is None
            if self._ended[k] == AFTER and self.names[k] not in self.lost:
                self._leave(k, f"{self.sources[k].name} ends at {self._periods[k].until_s:g} s")

    def _next(self, k: int) -> Frame | None:
        """Return a camera's next frame; None where it has ended, or is lost and the others go on."""
        try:
            frame = next(self._streams[k], None)
        except DeviceFailed as error:
            self._lose(k, error)
            frame = None
        return self._periods[k].see(frame)

    def _count(self, t_s: Sequence[float]) -> None:
        skew_s = max(t_s) - min(t_s) if self._partial else t_s[-1] - t_s[0]
        self._n += 1
        self._sum_s += skew_s
        if abs(skew_s) > abs(self._largest_s):
            self._largest_s = skew_s
        if self.untimed and not self.apart and len(t_s) > 1:
            self._spread_s2.append(2.0 * sum((one_s - sum(t_s) / len(t_s)) ** 2 for one_s in t_s) / (len(t_s) - 1))
            if len(self._spread_s2) == INTERVALS:
                self._tell_apart(math.sqrt(sum(self._spread_s2) / INTERVALS))
                self._spread_s2.clear()

    def _tell_apart(self, apart_s: float) -> None:
        """Tell once that cameras seem to expose at times that nothing says."""
        if apart_s > APART_S:
            self.apart = (
                f"The frames of {', '.join(self.names)} are {apart_s * 1e3:.0f} ms apart, and the rig's file does "
                "not say when its cameras expose: poses of a target that moves are worse than they claim, by some "
                f"{apart_s * 100.0:.1f} mm at 0.1 m/s. Run `armsight calibrate timing` once, trigger the cameras "
                "together, or let the target rest"
            )
            self._tell(self.apart)

    def _never_meet(self, there: dict[int, Frame]) -> DeviceFailed:
        times = [frame.t_s for frame in there.values()]
        return DeviceFailed(
            f"{UNPAIRED_LIMIT} frames of {' + '.join(source.name for source in self.sources)} in a row had no partner "
            f"within {self._max_skew_s * 1e3:.0f} ms (the last two were {(times[-1] - times[0]) * 1e3:.0f} ms apart)",
            consequence="No pair can be measured",
            cure="Set both cameras to the same frame rate, or allow more with --max-skew",
        )

    def _apart(self, k: int, apart_s: float) -> DeviceFailed:
        return DeviceFailed(
            f"no frame of {self.sources[k].name} came within {self._max_skew_s * 1e3:.0f} ms of the others' in "
            f"{UNPAIRED_LIMIT} moments (its last one is {apart_s:.3g} s from theirs)",
            consequence="Its clock or its frame rate is another: nothing it sees can be measured",
            cure="Set all cameras to one frame rate and one clock, or allow more with --max-skew",
        )


class RecordedMoments(TimedMoments):
    """Those of recordings, bags or videos, matched by time; end_together: one that ends before another is refused."""

    def __init__(
        self,
        *sources: FrameSource,
        end_together: bool = False,
        max_skew_s: float = MAX_SKEW_S,
        names: Sequence[str] = PAIR,
        fewest: int | None = None,
        tell: Callable[[str], None] = warnings.warn,
    ) -> None:
        super().__init__(*sources, names=names, max_skew_s=max_skew_s, fewest=fewest, tell=tell)
        self._end_together = end_together

    @property
    def name(self) -> str:
        """The recording's name, or all of them."""
        return " + ".join(dict.fromkeys(source.name for source in self.sources))

    def _moments(self, streams: Sequence[Iterator[Frame]]) -> Iterator[Moment]:
        try:
            yield from super()._moments(streams)
        except DeviceFailed as error:  # the rule is that of live cameras, the cause is in the file
            raise _never_together(error.cause) from error
        if self.skew is None and self.n_dropped:
            raise _never_together(f"no frame of {self.name} has a partner of its time")
        if self._end_together and self.short is not None and self.skew is not None:
            long = next(source for source in self.sources if source is not self.short)
            raise ended_early(self.short, long, self.skew.n_pairs)

    def _lose(self, k: int, why: DeviceFailed | Inconsistent) -> None:
        raise why  # a file does not come back, and its clock can be put right before


def _never_together(cause: str) -> Inconsistent:
    """Return the refusal of frames that never meet."""
    return Inconsistent(
        cause,
        consequence="Nobody can say which frames were taken together",
        cure="Check that both cameras were recorded on one clock, or allow more with --max-skew; with --fps, frames of "
        "two videos are paired by their number",
    )
