"""Which measured rows belong to which of the arm's: by order, or by time with the clocks laid on each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.arm.points import check_scale
from armsight.calibrate.timing.stamps import FEWEST_FRAMES, steady
from armsight.errors import DataRefused, Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm, fk
from armsight.verify.alignment import Align, left_handed
from armsight.verify.model import Mounts
from armsight.verify.records import Measured, Rejected
from armsight.verify.synchronise import Clock, JointStream, PoseStream, Stream, covered, gap_s, synchronise

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reported:
    """What the controller says: joint values q (n, joints), or commanded poses T (n, 4, 4); t_s (n,) where stamped.
    Rows that could not be read are NaN."""

    q: Array | None = None
    T: Array | None = None
    t_s: Array | None = None

    def __len__(self) -> int:
        return len(self.q) if self.q is not None else len(self.T) if self.T is not None else 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Paired:
    """Rows that belong together: measured (m rows) and the flange expected there F (m, 4, 4), with joints q, speed and
    acceleration (m, n) where there are; at_s (m,): on the arm's clock."""

    measured: Measured
    F: Array
    q: Array | None = None
    speed: Array | None = None
    acceleration: Array | None = None
    at_s: Array | None = None
    clock: Clock | None = None
    times: SamplingTimes | None = None
    rejected: Rejected = ()
    notes: tuple[str, ...] = ()


def bare_arm(arm: Arm) -> Arm:
    """Return the arm's chain alone, from base to flange, in the joints' own values."""
    identity = RigidTransform.identity()
    return replace(arm, T_world_base=identity, T_flange_tool=identity, couplings=(), covariance=None)


def pair(arm: Arm | None, reported: Reported, measured: Measured, nominal: Mounts, how: Align) -> Paired:
    """Return the rows that belong together: by order where one side has no stamps, else by time.

    Raises as sampling_times and synchronise; Inconsistent where rows without stamps are not as many.
    """
    if measured.t_s is None or reported.t_s is None:
        return _by_order(arm, reported, measured)
    return _by_time(arm, reported, measured, nominal, how)


def pair_at(arm: Arm | None, reported: Reported, measured: Measured, offset_s: float) -> Paired:
    """Return the rows that belong together where the arm's time is the measured one plus offset_s.

    Raises UsageError where one side has no stamps, NotEnoughData.
    """
    if measured.t_s is None:
        raise UsageError("the measured rows have no stamps")
    stream, notes = _stream(arm, reported)
    at = measured.t_s + offset_s
    there = covered(stream.t_s, at)
    chosen = np.flatnonzero(there)
    return Paired(
        measured=measured.take(chosen),
        F=stream.at(at[chosen])[0],
        q=stream.q_at(at[chosen]) if isinstance(stream, JointStream) else None,
        speed=stream.speed_at(at[chosen]) if isinstance(stream, JointStream) else None,
        at_s=at[chosen],
        rejected=tuple((int(measured.rows[i]), _uncovered(stream, float(at[i]))) for i in np.flatnonzero(~there)),
        notes=notes,
    )


def _by_order(arm: Arm | None, reported: Reported, measured: Measured) -> Paired:
    last = int(measured.rows.max())
    if last > len(reported):
        raise Inconsistent(
            f"{last} measured rows and {len(reported)} of the arm, at least one side without t_s",
            consequence="Which rows belong together is not known; nothing is verified",
            cure="Give one row of the arm for each measured row, in the same order, or t_s in both files",
        )
    notes = (
        () if last == len(reported) else (f"the arm's file has {len(reported) - last} rows more; they are not used",)
    )
    index = measured.rows - 1
    values = reported.q if reported.q is not None else reported.T
    if values is None:
        raise UsageError("neither joints nor commanded poses")
    good = np.isfinite(values[index].reshape(len(index), -1)).all(axis=1)
    lost = tuple((int(row), "the arm's row cannot be read") for row in measured.rows[~good])
    chosen, values = np.flatnonzero(good), values[index[good]]
    at_s = None if reported.t_s is None else reported.t_s[index[good]]
    part = measured.take(chosen)
    if arm is None or reported.q is None:
        return Paired(measured=part, F=values, at_s=at_s, rejected=lost, notes=notes)
    return Paired(measured=part, F=fk(bare_arm(arm), values), q=values, at_s=at_s, rejected=lost, notes=notes)


def _by_time(arm: Arm | None, reported: Reported, measured: Measured, nominal: Mounts, how: Align) -> Paired:
    if measured.t_s is None:
        raise UsageError("the measured rows have no stamps")
    stream, stream_notes = _stream(arm, reported)
    times = sampling_times(measured.t_s, "the measured rows")
    check_spread(measured, stream.at(stream.t_s[:: max(1, len(stream.t_s) // 2000)])[0])
    sure = np.flatnonzero(times.sure)
    clock = _clock(stream, measured.take(sure), times.t_s[sure], nominal, how)
    clock = replace(clock, std_s=float(np.hypot(clock.std_s, times.std_s)))
    at = clock.on_arm(times.t_s)
    there = covered(stream.t_s, at)
    doubtful = (
        "a row of its burst was lost, and its sampling time is open" if times.bursts else "repeats the stamp before"
    )
    rejected = [(int(row), doubtful) for row in measured.rows[~times.sure]]
    rejected += [(int(measured.rows[i]), _uncovered(stream, float(at[i]))) for i in np.flatnonzero(times.sure & ~there)]
    chosen = np.flatnonzero(times.sure & there)
    F, _ = stream.at(at[chosen])
    notes = (*stream_notes, *((times.note,) if times.note else ()), *clock.notes)
    return Paired(
        measured=measured.take(chosen),
        F=F,
        q=stream.q_at(at[chosen]) if isinstance(stream, JointStream) else None,
        speed=stream.speed_at(at[chosen]) if isinstance(stream, JointStream) else None,
        acceleration=stream.acceleration_at(at[chosen]) if isinstance(stream, JointStream) else None,
        at_s=at[chosen],
        clock=clock,
        times=times,
        rejected=tuple(rejected),
        notes=notes,
    )


def _clock(stream: Stream, measured: Measured, t_s: Array, nominal: Mounts, how: Align) -> Clock:
    """Return the clock; Inconsistent for left-handed positions where these agree once they are mirrored."""
    try:
        return synchronise(stream, measured, t_s, nominal, how)
    except Inconsistent as error:
        flipped = Measured(xyz_m=measured.xyz_m * [1.0, 1.0, -1.0], point=measured.point)
        try:
            synchronise(stream, flipped, t_s, nominal, Align.BOTH)
        except DataRefused:
            raise error from None
        raise left_handed("no time offset makes the path the arm's, and one does when it is mirrored") from error


def _uncovered(stream: Stream, at_s: float) -> str:
    if not stream.t_s[0] <= at_s <= stream.t_s[-1]:
        return "before the arm's first row or after its last one"
    i = int(np.searchsorted(stream.t_s, at_s))
    gap = stream.t_s[i] - stream.t_s[i - 1]
    return f"in a gap of {gap:.3g} s in the arm's rows, which are {np.median(np.diff(stream.t_s)):.3g} s apart"


def _stream(arm: Arm | None, reported: Reported) -> tuple[Stream, tuple[str, ...]]:
    """Return what the arm says over time, and what is to be known of its stamps."""
    values = reported.q if reported.q is not None else reported.T
    if values is None or reported.t_s is None:
        raise UsageError("neither joints nor commanded poses with stamps")
    good = np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    times = sampling_times(reported.t_s[good], "the arm's rows")
    use = times.sure & np.append(True, np.diff(times.t_s) > 0.0)
    t, values = times.t_s[use], values[good][use]
    if len(t) < 4:
        raise NotEnoughData(f"{len(t)} rows of the arm with stamps", consequence="No time offset can be told")
    notes = [times.note] if times.note else []
    gaps = int((np.diff(t) > gap_s(t)).sum())
    if gaps:
        notes.append(f"the arm's rows have {gaps} gap{'s' * (gaps > 1)} of more than {gap_s(t):.3g} s")
    if (~good).any():
        notes.append(f"{int((~good).sum())} of the arm's rows cannot be read and are left out")
    if arm is not None and reported.q is not None:
        return JointStream(bare_arm(arm), t, values), tuple(notes)
    return PoseStream(t, values), tuple(notes)


def check_spread(measured: Measured, F: Array) -> None:
    """Raise Inconsistent for positions in another unit than m."""
    position = F[:, :3, 3]
    expected = float(np.linalg.norm(position - position.mean(axis=0), axis=1).mean())
    seen = float(np.linalg.norm(measured.xyz_m - np.median(measured.xyz_m, axis=0), axis=1).mean())
    if expected > 1e-3:
        check_scale(expected, seen, "the arm moves its flange")


# When rows were sampled, from stamps that may be those of their delivery: bursts of rows share one instant.

Mask = NDArray[np.bool_]

SHARED = 0.2
"""Share of rows stamped as the row before from which the stamps are those of deliveries, not of samples."""
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
    if np.mean(step == 0.0) < SHARED:
        keep = np.concatenate([[True], step > 0.0])
        return SamplingTimes(t_s=t, bursts=False, sure=keep)
    return _spread(t, what)


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
