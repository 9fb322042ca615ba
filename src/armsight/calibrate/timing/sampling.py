"""When the rows of a log were sampled, from stamps that may be those of their delivery; readings across a full turn.

The one place in which the stamps of joints, poses and trackers are checked: order, repeats, bursts, stalls after which
rows come at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Mask
from armsight.calibrate.timing.stamps import FEWEST_FRAMES, steady
from armsight.errors import DataRefused, Inconsistent

SHARED = 0.2
"""Share of rows stamped as the row before from which the stamps are those of deliveries, not of samples."""
AT_ONCE, STALL = 0.1, 1.5
"""Rows within AT_ONCE of the usual step behind each other, after a step of more than STALL of it, came at once: a line
that stood still delivered them, and one clock sampled them."""
ON_TIME, ON_TIME_ROWS = 0.25, 0.98
"""A log is of a steady rate where so many of the rows that did not wait lie within this share of a period of it."""
WINDOW = 101
"""Deliveries over which the sampling clock is followed where they come at no steady rate."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SamplingTimes:
    """When rows were really sampled.

    t_s (n,): when each row was sampled, growing. bursts: the stamps were those of deliveries. sure (n,): False where
    rows of the delivery were lost, so that the others' times are open by some periods. std_s: of the sampling clock
    behind bursts. note: what to know of it."""

    t_s: Array
    bursts: bool
    sure: Mask
    std_s: float = 0.0
    note: str = ""


def sampling_times(stamps_s: Array, what: str) -> SamplingTimes:
    """Return when rows with these stamps (n,) were sampled; rows of one burst are spread over the time before it.

    what: whose stamps, in words. Raises Inconsistent where all stamps are equal, or where they fall.
    """
    t = np.asarray(stamps_s, float)
    step = np.diff(t)
    if len(t) > 1 and not np.ptp(t) > 0.0:
        raise Inconsistent(
            f"all {len(t)} stamps of {what} are {t[0]:.6g} s",
            consequence="When the rows were sampled is not known; nothing is compared by time",
            cure="Leave t_s out of both files where rows belong together by order, or export with real stamps",
        )
    if (step < 0.0).any():
        row = int(np.argmax(step < 0.0)) + 2
        raise Inconsistent(
            f"the time of {what} falls at row {row}, from {t[row - 2]:.6f} to {t[row - 1]:.6f} s",
            consequence="The rows have no order; nothing is compared by time",
            cure="Sort the rows, or split the file where the clock was set anew",
        )
    if np.mean(step == 0.0) >= SHARED:
        return _spread(t, what)
    return _stalled(t, what)


def _stalled(t: Array, what: str) -> SamplingTimes:
    """Return the times of rows some of which waited, and came at once: those of a steady rate, if they follow one.

    Else rows that came at once are not sure: they were sampled before, nobody knows when.
    """
    late = _waited(t)
    if not late.any():
        return SamplingTimes(t_s=t, bursts=False, sure=np.ones(len(t), bool))
    if len(t) >= FEWEST_FRAMES:
        try:
            clock = steady(t - t[0], what, complete=True)
        except DataRefused:
            pass
        else:
            on_time = np.abs(t - t[0] - clock.t_s) < ON_TIME * clock.period_s
            if np.mean(on_time[~late]) >= ON_TIME_ROWS:
                note = (
                    f"{late.sum()} of {len(t)} rows of {what} came at once after a stall: all are taken as sampled "
                    f"{clock.period_s:.4g} s apart"
                )
                std = float(np.sqrt(clock.clock_covariance(clock.mid_s)[0, 0]))
                return SamplingTimes(t_s=t[0] + clock.t_s, bursts=True, sure=on_time | late, std_s=std, note=note)
    note = f"{late.sum()} of {len(t)} rows of {what} came at once, nobody knows when they were sampled: not used"
    return SamplingTimes(t_s=t, bursts=False, sure=~late, note=note)


def _waited(t: Array) -> Mask:
    """Return which rows (n,) came at once: stamped alike, or close behind each other after a stall."""
    step = np.diff(t)
    late = np.zeros(len(t), bool)
    if not (step > 0.0).any():
        return late
    usual = float(np.median(step[step > 0.0]))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (step < AT_ONCE * usual).astype(int), [0]])))
    for first, last in zip(edges[::2], edges[1::2], strict=True):  # rows first .. last, quick steps between them
        late[first : last + 1] = (step[first:last] == 0.0).any() or (first > 0 and step[first - 1] > STALL * usual)
    return late


def _spread(t: Array, what: str) -> SamplingTimes:
    """Return the times of rows in bursts: the last row of each is taken as just delivered."""
    ends = np.flatnonzero(np.diff(np.append(t, np.inf)) > 0.0)
    size = np.diff(np.append(-1, ends))
    burst = np.repeat(np.arange(len(ends)), size)
    back = ends[burst] - np.arange(len(t))  # rows until the burst's last
    usual = int(np.median(size))
    regular = np.mean(size >= usual - 1) > 0.9 and size.max() <= usual + 1 and usual > 1
    if regular and len(ends) >= FEWEST_FRAMES:
        try:
            clock = steady(t[ends], what)
        except Inconsistent:
            pass
        else:
            period = clock.period_s / usual
            sure = (size == usual)[burst]
            note = f"{what} came in bursts of {usual} rows every {clock.period_s:.4g} s: taken {period:.4g} s apart"
            times = clock.t_s[burst] - period * back
            std = float(np.sqrt(clock.clock_covariance(clock.mid_s)[0, 0]))
            return SamplingTimes(t_s=times, bursts=True, sure=sure, std_s=std, note=note)
    return _followed(t, ends, burst, back, what)


def _followed(
    t: Array, ends: NDArray[np.intp], burst: NDArray[np.intp], back: NDArray[np.intp], what: str
) -> SamplingTimes:
    """Return the times of rows in bursts of any size: lines of the deliveries over the number of rows, bit by bit."""
    number = ends.astype(float)
    out = np.empty(len(t))
    half = min(WINDOW, len(ends)) // 2
    for b in range(len(ends)):
        low = int(np.clip(b - half, 0, max(len(ends) - 2 * half - 1, 0)))
        part = slice(low, low + 2 * half + 1)
        slope, level = np.polyfit(number[part] - number[b], t[ends[part]], 1) if half else (0.0, t[ends[b]])
        mine = burst == b
        out[mine] = level - slope * back[mine]
    out = np.maximum.accumulate(out + 1e-9 * np.arange(len(t)))
    note = f"{what} came in bursts of uneven size: their sampling times are those of a steady clock to about a period"
    off = t[ends] - out[ends]
    std = float(np.std(off) / np.sqrt(max(len(ends), 1)))
    return SamplingTimes(t_s=out, bursts=True, sure=np.ones(len(t), bool), std_s=std, note=note)


def without_seams(q: Array) -> Array:
    """Return a log's readings (n, joints), rows in order, without the jumps of angles that are written within one turn.

    Rows of NaN stay. No slide moves by pi metres from row to row.
    """
    out = np.array(q, float)
    good = np.isfinite(out).all(axis=1)
    out[good] = np.unwrap(out[good], axis=0)
    return out
