"""Rows in which nothing was measured, however the program that wrote them says so: decided here, once, for every table.

Trackers fill a lost frame with nothing, `nan`, zeros, zeros and the identity, one number such as -9999 in every cell,
or the last pose again; some lose the rotation alone, and logs a joint. Such a row is left out before any clock, fit or
pairing sees it. It is never filled.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from armsight.arrays import Array, Mask
from armsight.columns import POSITION, QUATERNION
from armsight.errors import NotEnoughData
from armsight.store.tables import Table, filled, known, zeros

LEADS = ("", "base_flange_", "camera_target_")
EMPTY, PARTLY, ZEROS, NO_ROTATION, AGAIN, FILLED, JOINT_ZERO = (
    *("empty", "partly empty", "zeros", "without a rotation", "the values of the row before, while all moves on"),
    *("one number in x, y and z", "a joint that drops to zero and comes back"),
)
JUMP = 1.5
"""A value that stood still is stale where it then moves so many times as fast as before and after: a tracker that holds
the last pose for k frames jumps by k + 1 of its steps, an arm that rested starts slower than it goes on."""
STEPS_AT_ONCE = 4.0
"""... and by so many of the smallest steps of the numbers: rests in rounded numbers jump by one or two."""
POLLED = 0.5
"""Where so many of the values of a motion stand twice or more, a program polled faster than there were new ones."""
JUMP_HOME, LEAST_HOME = 10.0, 0.05
"""Joints at zero in the midst of a motion are lost where the rows beside them are so many usual steps, and so much (rad
or m), away: a log that begins at the zero position moves on from there."""
MOST_DROPPED = 0.1
"""A joint that stands at zero in more of the rows than this was moved there."""
ROTATION_RARE = 0.5
"""Where a larger share of rows has a position only, the rotations are left out instead of the rows."""

NOTHING_LEFT = (
    "Check what was recorded; columns that are not used are named - in --columns (of one of two tables: write it anew, "
    "armsight convert table FILE --columns ... -o NEW.csv)"
)


def lost_rows(table: Table, *, measured: bool = True, groups: Sequence[Sequence[str]] = ()) -> dict[int, str]:
    """Return the rows (from 0) in which nothing was measured, or a part of it is missing, with what stands there.

    A position is POSITION behind one of LEADS, with the rotation beside it; joints are q1, q2, ...; groups: further
    columns that are measured together. measured: False for what was asked for, which may be zero or the same again.
    Rows with a status are judged where it is ok.
    """
    n = len(table)
    why = np.full(n, "", dtype=object)
    status = table.text.get("status")
    judged = np.ones(n, bool) if status is None else np.array([word in ("", "ok") for word in status], bool)

    def mark(rows: Mask, what: str) -> None:
        why[rows & judged & (why == "")] = what

    joints = table.series("q")
    parts = [part for lead in LEADS if (part := _pose_columns(table, lead))]
    for position, rotation in parts:
        _judge_pose(table, position, rotation, measured, mark)
    for names in (joints, *groups):
        if not names:
            continue
        values = table.stacked(names)
        there = known(values)
        mark(np.asarray(~there.any(axis=1)), EMPTY)
        mark(np.asarray(~there.all(axis=1)), PARTLY)
        if measured and names is not joints:
            mark(zeros(values), ZEROS)
    if measured and "t_s" in table.numbers:
        t_s = table.numbers["t_s"]
        moving = [table.stacked((*position, *rotation)) for position, rotation in parts]
        moving += [table.stacked(joints)] if joints else []
        good = np.flatnonzero((why == "") & judged & np.isfinite(t_s))
        for values in moving:
            stale = np.zeros(n, bool)
            stale[good] = _stale(t_s[good], values[good])
            mark(stale, AGAIN)
        if joints:
            away = np.zeros(n, bool)
            away[good] = _away_at_zero(table.stacked(joints)[good])
            mark(away, ZEROS)
            for name in joints:
                dropped = np.zeros(n, bool)
                dropped[good] = _drops_to_zero(table.numbers[name][good])
                mark(dropped, JOINT_ZERO)
    return {int(row): why[row] for row in np.flatnonzero(why != "")}


def without_lost(
    table: Table, notify: Callable[[str], None], *, measured: bool = True, groups: Sequence[Sequence[str]] = ()
) -> Table:
    """Return the table without its lost rows (lost_rows), which are told. Raises NotEnoughData where none is left."""
    lost = lost_rows(table, measured=measured, groups=groups)
    if not lost:
        return table
    words = f"{table.where}: {lost_words(lost, table)}"
    if len(lost) == len(table):
        raise NotEnoughData(words, consequence="No row is left", cure=NOTHING_LEFT)
    notify(words)
    return table.take([row for row in range(len(table)) if row not in lost])


def without_rare_rotations(table: Table, notify: Callable[[str], None]) -> Table:
    """Return the table without its rotations, which is told, where most rows have none: the rows would be lost else."""
    if not all(name in table.numbers for name in (*POSITION, *QUATERNION)):
        return table
    placed = known(table.stacked(POSITION)).all(axis=1)
    quat = table.stacked(QUATERNION)
    turned = placed & known(quat).all(axis=1) & ~zeros(quat)
    if not placed.any() or turned.sum() >= (1.0 - ROTATION_RARE) * placed.sum():
        return table
    missing = int(placed.sum() - turned.sum())
    if turned.any():
        notify(f"{table.where}: {missing} of {len(table)} rows have no rotation: the positions alone are used")
    return table.without_columns(QUATERNION)


def lost_words(lost: Mapping[int, str], table: Table) -> str:
    """Return how many rows are lost, as what, and in which lines."""
    kinds = Counter(lost.values())
    what = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
    several = len(lost) > 1
    return (
        f"{len(lost)} of {len(table)} rows {'are' if several else 'is'} lost and not used ({what}): "
        f"line{'s' * several} {_ranges([table.lines[row] for row in lost])}"
    )


MOST_SPANS = 12


def _ranges(lines: Sequence[int]) -> str:
    """Return lines such as '32-34, 79', at most some of them."""
    spans: list[list[int]] = []
    for line in lines:
        if spans and line == spans[-1][1] + 1:
            spans[-1][1] = line
        else:
            spans.append([line, line])
    words = [f"{a}-{b}" if b > a else f"{a}" for a, b in spans[:MOST_SPANS]]
    return ", ".join(words) + (f" and {len(spans) - MOST_SPANS} more places" if len(spans) > MOST_SPANS else "")


def _pose_columns(table: Table, lead: str) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Return the columns of a position and of the rotation beside it, () without one; None without a position."""
    position, rotation = (tuple(f"{lead}{name}" for name in names) for names in (POSITION, QUATERNION))
    if not all(name in table.numbers for name in position):
        return None
    return position, rotation if all(name in table.numbers for name in rotation) else ()


def _judge_pose(
    table: Table,
    position: Sequence[str],
    rotation: Sequence[str],
    measured: bool,
    mark: Callable[[Mask, str], None],
) -> None:
    xyz, quat = table.stacked(position), table.stacked(rotation)
    there = known(np.concatenate([xyz, quat], axis=1))
    mark(np.asarray(~there.any(axis=1)), EMPTY)
    unturned = np.asarray(~there[:, 3:].any(axis=1) | zeros(quat)) if rotation else np.zeros(len(table), bool)
    zero = zeros(xyz)
    if measured and _rare(xyz, zero):
        mark(zero, ZEROS)
    same = filled(xyz)
    if measured and _rare(xyz, same):
        mark(same, FILLED)
    mark(unturned & there[:, :3].all(axis=1), NO_ROTATION)
    mark(np.asarray(~there.all(axis=1)), PARTLY)


def _rare(xyz: Array, zero: Mask) -> bool:
    """Whether positions at zero are none that were measured: the others are all different, and as many at least.

    A tool that touches few known points has the same positions again and again, one of them maybe at zero.
    """
    others = xyz[~zero & known(xyz).all(axis=1)]
    return bool(len(others) >= zero.sum() and len(np.unique(others, axis=0)) > 0.5 * len(others))


def _stale(t_s: Array, values: Array) -> Mask:
    """Return which rows (n,) of a stream repeat the values (n, k) before them to the last digit while all moves."""
    n = len(values)
    out = np.zeros(n, bool)
    same = (values[1:] == values[:-1]).all(axis=1)
    if n < 4 or not same.any() or same.all():
        return out
    first = np.flatnonzero(np.append(True, ~same))
    last = np.append(first[1:] - 1, n - 1)
    step = np.abs(np.diff(values[first], axis=0))
    size = np.linalg.norm(step, axis=1)
    speed = size / np.maximum(t_s[first[1:]] - t_s[last[:-1]], 0.5 * np.median(np.diff(t_s)) + 1e-12)
    finest = float(step[step > 0.0].min())
    held = last > first
    inside = np.flatnonzero(held[1:-1]) + 1  # values with one before and one after them
    before, after = speed[inside - 1], speed[inside]
    onward = np.append(speed, 0.0)[inside + 1]
    jumps = (after > JUMP * np.maximum(before, onward)) & (size[inside] > STEPS_AT_ONCE * finest) & (before > 0.0)
    usual = float(np.median(size))
    moves = (size[inside - 1] > 0.5 * usual) & (size[inside] > 0.5 * usual)
    moving = (size[:-1] > 0.5 * usual) & (size[1:] > 0.5 * usual)
    polled = moving.any() and moves.sum() >= POLLED * moving.sum() and usual > STEPS_AT_ONCE * finest
    for j in inside[jumps | (moves if polled else False)]:
        rows = slice(first[j] + 1, last[j] + 1)
        out[rows] = t_s[rows] > t_s[first[j]]  # else the same row twice, which in_time tells
    return out


def _away_at_zero(q: Array) -> Mask:
    """Return which rows (n,) hold joints at zero in the midst of a motion elsewhere."""
    zero = zeros(q)
    out = np.zeros(len(q), bool)
    others = q[~zero]
    if not zero.any() or len(others) < 3:
        return out
    usual = float(np.median(np.abs(np.diff(others, axis=0)).max(axis=1)))
    far = max(JUMP_HOME * usual, LEAST_HOME)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], zero.astype(int), [0]])))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        beside = [np.abs(q[k]).max() for k in (start - 1, end) if 0 <= k < len(q)]
        out[start:end] = min(beside) > far
    return out


def _drops_to_zero(q: Array) -> Mask:
    """Return which readings (n,) of one joint are zero in the midst of others, to which it comes back."""
    zero = q == 0.0
    out = np.zeros(len(q), bool)
    steps = np.abs(np.diff(q[~zero]))
    if not zero.any() or zero.mean() > MOST_DROPPED or not steps.any():
        return out
    far = max(JUMP_HOME * float(np.median(steps[steps > 0.0])), LEAST_HOME)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], zero.astype(int), [0]])))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if start > 0 and end < len(q):
            before, after = q[start - 1], q[end]
            out[start:end] = abs(after - before) < 0.5 * min(abs(before), abs(after)) > 0.5 * far
    return out
