"""Which measured rows belong to which of the arm's: by order, or by time with the clocks laid on each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.calibrate.arm.points import ArmPoints, check_scale
from armsight.calibrate.arm.rotations import computed
from armsight.calibrate.arm.senses import other_senses
from armsight.calibrate.timing.sampling import SamplingTimes, sampling_times, without_seams
from armsight.errors import DataRefused, Inconsistent, NotEnoughData, UsageError
from armsight.kinematics import Arm, fk
from armsight.units import MM
from armsight.verify.alignment import Align, left_handed
from armsight.verify.model import Mounts
from armsight.verify.records import Measured, Rejected
from armsight.verify.synchronise import Clock, JointStream, PoseStream, Stream, covered, gap_s, synchronise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reported:
    """What the controller says: joint values q (n, joints), or commanded poses T (n, 4, 4); t_s (n,) where stamped.
    Rows that could not be read are NaN. readings: (n, joints) as the log has them, where q are made of them."""

    q: Array | None = None
    T: Array | None = None
    t_s: Array | None = None
    readings: Array | None = None

    def values_of(self, arm: Arm) -> Reported:
        """Return it with the joints' own values in place of the readings, which may jump by a turn in a log."""
        if self.q is None:
            return self
        q = self.q if self.t_s is None else without_seams(self.q)
        return replace(self, q=q if arm.direct else arm.values(q), readings=self.q)

    def in_their_turn(self, q: Array, at_s: Array) -> Array:
        """Return readings (m, joints) at times (m,) within the turn of the log's row nearest in time."""
        if self.readings is None or self.t_s is None:
            return q
        good = np.isfinite(self.readings).all(axis=1)
        t_s, log = self.t_s[good], self.readings[good]
        after = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
        near = log[after - (at_s - t_s[after - 1] < t_s[after] - at_s)]
        return np.asarray(q - 2.0 * np.pi * np.round((q - near) / (2.0 * np.pi)))

    def __len__(self) -> int:
        return len(self.q) if self.q is not None else len(self.T) if self.T is not None else 0


CLOCK_ROUNDS = 2
"""In which clocks are laid anew by the zeros that were found, ..."""
CLOCK_SETTLED = 0.2
"""... until the offset moves by less than this share of its standard deviation."""
MOVED_M, MOVED_RAD = 5e-4, 2e-3
"""An arm that moved by so much does not measure the same to the last digit."""
Clocked = tuple[Arm, float]
"""An arm by whose motion clocks are laid, and nearly their offset in s."""
ENOUGH_TURNS = 6
"""Rows below which rotations may follow an arm to the last digits by the fit of base and tool alone."""


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
    joints = tuple(replace(joint, driven=True) for joint in arm.joints)
    return replace(arm, joints=joints, couplings=(), T_world_base=identity, T_flange_tool=identity, covariance=None)


def without_computed(paired: Paired) -> Paired:
    """Return rows without rotations that are those expected to the last digits where positions are not, and a note."""
    seen = paired.measured
    if seen.rotation is None or len(seen) < ENOUGH_TURNS:
        return paired
    q = np.zeros((len(seen), 1))
    told = computed(paired.F, ArmPoints(q=q, xyz_m=seen.xyz_m, rotation=seen.rotation, point=seen.point))
    return replace(paired, measured=replace(seen, rotation=None), notes=(*paired.notes, told)) if told else paired


def pair(
    arm: Arm | None,
    reported: Reported,
    measured: Measured,
    nominal: Mounts,
    how: Align,
    *,
    clocked: Clocked | None = None,
) -> Paired:
    """Return the rows that belong together: by order where one side has no stamps, else by time.

    clocked: the arm by whose motion the clocks are laid, where it is known better than the one that is verified, and
    nearly the offset in s.
    Raises as sampling_times and synchronise; Inconsistent where rows without stamps are not as many.
    """
    if measured.t_s is None or reported.t_s is None:
        return _by_order(arm, reported, measured)
    return _by_time(arm, reported, measured, nominal, how, clocked)


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
            cure="Give one row of the arm for each measured row, in the same order, or t_s in both files; where it "
            "rested at each, `armsight join --still` makes one row of each rest of a recording",
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


def _by_time(
    arm: Arm | None, reported: Reported, measured: Measured, nominal: Mounts, how: Align, clocked: Clocked | None
) -> Paired:
    if measured.t_s is None:
        raise UsageError("the measured rows have no stamps")
    stream, stream_notes = _stream(arm, reported)
    times = sampling_times(measured.t_s, "the measured rows")
    check_spread(measured, stream.at(stream.t_s[:: max(1, len(stream.t_s) // 2000)])[0])
    sure = np.flatnonzero(times.sure)
    by, near_s = (stream, None) if clocked is None else (_stream(clocked[0], reported)[0], clocked[1])
    clock = _clock(by, measured.take(sure), times.t_s[sure], nominal, how, near_s)
    clock = replace(clock, std_s=float(np.hypot(clock.std_s, times.std_s)))
    at = clock.on_arm(times.t_s)
    there = covered(stream.t_s, at)
    doubtful = (
        "a row of its burst was lost, and its sampling time is open"
        if times.bursts
        else "came at once with others: when it was sampled is not known"
    )
    rejected = [(int(row), doubtful) for row in measured.rows[~times.sure]]
    rejected += [(int(measured.rows[i]), _uncovered(stream, float(at[i]))) for i in np.flatnonzero(times.sure & ~there)]
    chosen = np.flatnonzero(times.sure & there)
    notes = (*stream_notes, *((times.note,) if times.note else ()), *clock.notes)
    return Paired(
        measured=measured.take(chosen),
        F=stream.at(at[chosen])[0],
        q=stream.q_at(at[chosen]) if isinstance(stream, JointStream) else None,
        speed=stream.speed_at(at[chosen]) if isinstance(stream, JointStream) else None,
        acceleration=stream.acceleration_at(at[chosen]) if isinstance(stream, JointStream) else None,
        at_s=at[chosen],
        clock=clock,
        times=times,
        rejected=tuple(rejected),
        notes=notes,
    )


def _clock(stream: Stream, measured: Measured, t_s: Array, nominal: Mounts, how: Align, near_s: float | None) -> Clock:
    """Return the clock; Inconsistent for left-handed positions where these agree once they are mirrored."""
    try:
        return synchronise(stream, measured, t_s, nominal, how, near_s)
    except Inconsistent as error:
        flipped = Measured(xyz_m=measured.xyz_m * [1.0, 1.0, -1.0], point=measured.point)
        try:
            synchronise(stream, flipped, t_s, nominal, Align.BOTH)
        except DataRefused:
            if isinstance(stream, JointStream):  # stamped by one clock, as far as these rows tell
                check_senses(stream.bare, stream.q_at(t_s), measured, np.flatnonzero(covered(stream.t_s, t_s)))
            raise error from None
        raise left_handed("no time offset makes the path the arm's, and one does when it is mirrored") from error


def check_senses(arm: Arm | None, q: Array | None, measured: Measured, rows: NDArray[np.intp]) -> None:
    """Raise Inconsistent where the arm explains rows once some of its joints, q (n, joints), count the other way."""
    if arm is None or q is None:
        return
    part = measured.take(rows)
    found = other_senses(arm, ArmPoints(q=q[rows], xyz_m=part.xyz_m, point=part.point))
    # a mirrored frame is as if nearly all joints ran the other way, and is told as that; zeros are found and told here
    if found is not None and (found[0].exchanged or 0 < len(found[0].joints) <= arm.n // 2):
        raise found[0].refusal(arm, found[1])


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


def repeated(F: Array, measured: Measured) -> Rejected:
    """Return the rows that repeat the row before of their point, digit by digit, though the arm moved between.

    F (m, 4, 4): base to flange as expected at each row.
    """
    found: list[tuple[int, str]] = []
    for label in measured.labels:
        rows = np.flatnonzero([point == label for point in measured.point])
        first = rows[0] if len(rows) else 0
        for i in rows[1:].tolist():
            if not _same(measured, i, first):
                first = i
                continue
            moved = float(np.linalg.norm(F[i, :3, 3] - F[first, :3, 3]))
            turned = float(np.abs(F[i, :3, :3] - F[first, :3, :3]).max())
            if moved > MOVED_M or turned > MOVED_RAD:
                why = (
                    f"repeats row {measured.rows[first]} to the last digit though the arm moved by {moved / MM:.3g} mm"
                )
                found.append((int(measured.rows[i]), why))
    return tuple(sorted(found))


def _same(measured: Measured, i: int, k: int) -> bool:
    if not np.array_equal(measured.xyz_m[i], measured.xyz_m[k]):
        return False
    return measured.rotation is None or np.array_equal(measured.rotation[i], measured.rotation[k])
