"""Which spot is which light, in two cameras, where several lights have no names.

In each camera spots are followed from frame to frame; a stretch ends where two ways to go on are nearly as short. The
delay comes from the lights' mean, which needs no names. Stretches of both cameras that overlap are then tied together
by their distance from the epipolar lines over all that time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np
import scipy  # loads its optimize where it is used

from armsight.arrays import Array, Index
from armsight.calibrate.timing.coarse import MAX_GAP, coarse_delay
from armsight.calibrate.timing.views import common_lights
from armsight.errors import DataRefused, NotEnoughData
from armsight.optics import SIDES, Rig
from armsight.optics.triangulate import epipolar_distance
from armsight.records import SpotTrack

MEAN = "mean"
LIGHT = "light"
"""Name of the only light, where nobody named it."""
MOST_LIGHTS = 6
CLEAR = 3.0
"""The second shortest way on must be this many times as long as the shortest, or the stretch ends."""
SHORTEST = 5
"""Frames of a stretch that is used."""
FEWEST_IN_COMMON = 5
CLEAR_EPIPOLAR = 1.5


@dataclass(slots=True)
class _Stretch:
    """Frames (n,) of one camera, times (n,), and spots rows (n, k): column = light within the stretch."""

    t_s: Array
    rows: Index


def named_by_motion(
    rig: Rig, tracks: tuple[SpotTrack, SpotTrack], times_s: tuple[Array, Array], k: int
) -> tuple[SpotTrack, SpotTrack]:
    """Return the tracks with the lights named 1, 2, ...; frames in which they cannot be told apart lose their spots.

    times_s: of the frames of each camera. k: how many lights there are; frames that hold another number of spots are
    not used. Raises NotEnoughData, and as coarse_delay.
    """
    if k > MOST_LIGHTS:
        raise NotEnoughData(
            f"{k} lights are more than can be told apart",
            consequence="The lights cannot be named",
            cure=f"Wave a target of up to {MOST_LIGHTS} lights before a dark ground, or give --threshold",
        )
    complete = [_complete_frames(track, k) for track in tracks]
    mean = (_mean_track(tracks[0], complete[0]), _mean_track(tracks[1], complete[1]))
    delay = coarse_delay(rig, mean, times_s, MEAN)
    stretches = [
        _stretches(track, time + side * delay, frames)
        for side, (track, time, frames) in enumerate(zip(tracks, times_s, complete, strict=True))
    ]
    ties = _ties(rig, tracks, stretches)
    names = _spread(ties, [len(each) for each in stretches], [[len(s.t_s) for s in each] for each in stretches], k)
    return _renamed(tracks[0], stretches[0], names[0]), _renamed(tracks[1], stretches[1], names[1])


def lights_named(
    names: Sequence[str], tracks: Sequence[SpotTrack], n_lights: int | None
) -> tuple[list[SpotTrack], int]:
    """Return tracks whose lights have names, as given or of the only light, and 1; of several lights that nobody named
    the tracks as they are, and how many lights there are.

    names: of the cameras. Raises NotEnoughData where some cameras' spots have names and others' have not.
    """
    named = [any(track.names) for track in tracks]
    if all(named):
        return list(tracks), 1
    if any(named):
        if len({name for track in tracks for name in track.names} - {""}) > 1:
            raise NotEnoughData(
                f"the {names[named.index(False)]} camera's spots have no names, the other "
                f"{'one' if len(names) == 2 else 'cameras'}'s have",
                consequence="Nobody can say which spot is which light",
                cure="Name the lights in both tables, or in none",
            )
        tracks = [track.renamed("") for track in tracks]
    count = 1 if all(track.alone for track in tracks) else n_lights or usual_count(tracks)
    return [only_light(track) for track in tracks] if count == 1 else list(tracks), count


def only_light(track: SpotTrack) -> SpotTrack:
    """Return the spots of frames that hold but one, with a name."""
    rows = _complete_frames(track, 1)[:, 0]
    return SpotTrack(
        t_s=track.t_s,
        frame=track.frame[rows],
        names=(LIGHT,) * len(rows),
        uv_px=track.uv_px[rows],
        covariance_px2=track.covariance_px2[rows],
    )


def usual_count(tracks: Sequence[SpotTrack]) -> int:
    """Return how many spots most frames hold that hold any."""
    counts = np.concatenate([np.bincount(track.frame, minlength=len(track)) for track in tracks])
    return int(np.argmax(np.bincount(counts[counts > 0]))) if counts.any() else 0


def _complete_frames(track: SpotTrack, k: int) -> Index:
    """Return the rows (n, k) of the spots of frames that hold just k of them."""
    counts = np.bincount(track.frame, minlength=len(track))
    first = np.concatenate([[0], np.cumsum(counts)])[:-1]
    return np.asarray(first[counts == k][:, None] + np.arange(k), dtype=np.intp)


def _mean_track(track: SpotTrack, rows: Index) -> SpotTrack:
    return SpotTrack(
        t_s=track.t_s,
        frame=track.frame[rows[:, 0]],
        names=(MEAN,) * len(rows),
        uv_px=track.uv_px[rows].mean(axis=1),
        covariance_px2=track.covariance_px2[rows].mean(axis=1) / rows.shape[1],
    )


def _stretches(track: SpotTrack, times_s: Array, rows: Index) -> list[_Stretch]:
    """Return the stretches over which each light can be followed."""
    t = times_s[track.frame[rows[:, 0]]]
    period = float(np.median(np.diff(t)))
    out: list[_Stretch] = []
    begin, order = 0, rows.copy()
    for n in range(1, len(rows)):
        before = order[max(begin, n - 2) : n]
        step = _step(track.uv_px, before, t[max(begin, n - 2) : n], rows[n], float(t[n]))
        if step is None or t[n] - t[n - 1] > MAX_GAP * period:
            out.append(_Stretch(t[begin:n], order[begin:n]))
            begin = n
        else:
            order[n] = rows[n][step]
    out.append(_Stretch(t[begin:], order[begin:]))
    return [each for each in out if len(each.t_s) >= SHORTEST]


def _step(uv: Array, before: Index, t_before: Array, rows: Index, t: float) -> Index | None:
    """Return which spot each light went to; None where another way is nearly as short."""
    last = uv[before[-1]]
    ahead = last
    if len(before) == 2:
        # on at the speed of the two frames before: lights that cross would else change their names
        ahead = last + (last - uv[before[0]]) * (t - t_before[-1]) / (t_before[-1] - t_before[0])
    cost = np.sum((ahead[:, None] - uv[rows][None]) ** 2, axis=2)
    own, to = scipy.optimize.linear_sum_assignment(cost)
    least = cost[own, to].sum()
    for i in range(len(own)):  # the second best way avoids one of the best one's steps
        other = cost.copy()
        other[own[i], to[i]] = 1e12
        if other[scipy.optimize.linear_sum_assignment(other)].sum() < CLEAR**2 * least + 1.0:
            return None
    return np.asarray(to, dtype=np.intp)


def _ties(
    rig: Rig, tracks: tuple[SpotTrack, SpotTrack], stretches: list[list[_Stretch]]
) -> list[tuple[int, int, Index]]:
    """Return (left stretch, right stretch, right column of each left light) where this is clear, the longest first."""
    found = []
    for a, left in enumerate(stretches[0]):
        for b, right in enumerate(stretches[1]):
            inside = np.flatnonzero((left.t_s >= right.t_s[0]) & (left.t_s <= right.t_s[-1]))
            if len(inside) < FEWEST_IN_COMMON:
                continue
            tie = _tie(rig, tracks, left, right, inside)
            if tie is not None:
                found.append((len(inside), a, b, tie))
    return [(a, b, tie) for _, a, b, tie in sorted(found, key=lambda each: -each[0])]


def _tie(rig: Rig, tracks: tuple[SpotTrack, SpotTrack], left: _Stretch, right: _Stretch, inside: Index) -> Index | None:
    k = left.rows.shape[1]
    cost = np.empty((k, k))
    theirs = tracks[1].uv_px[right.rows]  # (n, k, 2)
    for j in range(k):
        at = np.stack([np.interp(left.t_s[inside], right.t_s, theirs[:, j, axis]) for axis in (0, 1)], axis=1)
        for i in range(k):
            apart = epipolar_distance(rig, tracks[0].uv_px[left.rows[inside, i]], at)
            cost[i, j] = np.mean(np.square(apart))
    if not np.isfinite(cost).all():
        return None
    ways = [(sum(cost[i, j] for i, j in enumerate(way)), way) for way in permutations(range(k))]
    ways.sort()
    if ways[1][0] < CLEAR_EPIPOLAR**2 * ways[0][0]:
        return None
    return np.array(ways[0][1], dtype=np.intp)


def _spread(
    ties: list[tuple[int, int, Index]], counts: list[int], lengths: list[list[int]], k: int
) -> tuple[list[Index | None], list[Index | None]]:
    """Return the light of each column of each stretch, from the longest tied stretch on; None where none is tied."""
    names: tuple[list[Index | None], list[Index | None]] = ([None] * counts[0], [None] * counts[1])
    best, most = names, 0
    started: set[int] = set()
    for a, _, _ in ties:
        if a in started:
            continue
        names = ([None] * counts[0], [None] * counts[1])
        names[0][a] = np.arange(k)
        _follow(ties, names)
        started |= {i for i, each in enumerate(names[0]) if each is not None}
        size = sum(n for side in (0, 1) for n, each in zip(lengths[side], names[side], strict=True) if each is not None)
        if size > most:
            best, most = names, size
    if not most:
        raise NotEnoughData(
            "the lights cannot be told apart by their motion",
            consequence="No timing is given",
            cure="Wave a single light, or turn the target so that its lights neither cross nor share rows; or name "
            "them in tables of spots",
        )
    return best


def _follow(ties: list[tuple[int, int, Index]], names: tuple[list[Index | None], list[Index | None]]) -> None:
    changed = True
    while changed:
        changed = False
        for a, b, tie in ties:
            left, right = names[0][a], names[1][b]
            if left is not None and right is None:
                names[1][b] = np.empty_like(left)
                names[1][b][tie] = left  # type: ignore[index]
                changed = True
            elif right is not None and left is None:
                names[0][a] = right[tie]
                changed = True


def _renamed(track: SpotTrack, stretches: list[_Stretch], names: list[Index | None]) -> SpotTrack:
    light = np.full(len(track.names), -1)
    for stretch, name in zip(stretches, names, strict=True):
        if name is not None:
            light[stretch.rows] = name
    kept = np.flatnonzero(light >= 0)
    return SpotTrack(
        t_s=track.t_s,
        frame=track.frame[kept],
        names=tuple(str(light[i] + 1) for i in kept),
        uv_px=track.uv_px[kept],
        covariance_px2=track.covariance_px2[kept],
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tied:
    """The cameras of a rig, by their places there, that are tied to the first one.

    names: of all cameras. tracks: with named lights. delay_s (n,). refused: why each other camera is not, by name.
    """

    names: tuple[str, ...]
    cameras: tuple[int, ...]
    tracks: Sequence[SpotTrack]
    delay_s: Array
    refused: Mapping[str, DataRefused]

    def error(self) -> DataRefused:
        """Return what says which cameras are not tied, and why the first of them is not."""
        name, why = next(iter(self.refused.items()))
        given = [self.names[k] for k in self.cameras]
        others = f", nor that of {', '.join(list(self.refused)[1:])}" if len(self.refused) > 1 else ""
        return type(why)(
            f"nothing ties the clock of {name} to {given[0]}'s{others}: {why.cause}",
            consequence=f"The timing of {', '.join(given)} alone is given" if given[1:] else "No timing is given",
            cure=why.cure,
        )


def tied_cameras(
    rig: Rig,
    tracks: Mapping[int, SpotTrack],
    times_s: Mapping[int, Array],
    n_lights: int | None,
    refused: Mapping[str, DataRefused],
) -> Tied:
    """Return the cameras that a chain of common sights ties to the first one, by their best seen neighbour each.

    tracks, times_s: by place in the rig, of those whose stamps are steady. refused: of the others.
    """
    named, count = lights_named([rig.names[k] for k in tracks], list(tracks.values()), n_lights)
    found = dict(zip(tracks, named, strict=True))
    delay_s, why, tried = {0: 0.0}, dict(refused), set()
    known: dict[int, SpotTrack] = found if count == 1 else {}
    while edges := [(-_sights(found, a, b), a, b) for a in delay_s for b in found if b not in delay_s]:
        edges = [edge for edge in edges if edge[1:] not in tried]
        if not edges:
            break
        # the edge with most sights first: a maximal spanning tree, grown from the first camera (Prim 1957)
        _, a, b = min(edges)
        tried.add((a, b))
        try:
            if count > 1:
                known |= _named_like(rig, found, known, times_s, (a, b), count)
            pair = Rig(cameras=(rig.cameras[a], rig.cameras[b]))
            both = (known[a], known[b])
            late = coarse_delay(pair, both, (times_s[a], times_s[b]), common_lights(*both)[0])
        except DataRefused as error:
            why.setdefault(rig.names[b], error)
            continue
        delay_s[b] = delay_s[a] + late
        why.pop(rig.names[b], None)
    cameras = tuple(sorted(delay_s))
    return Tied(
        names=rig.names,
        cameras=cameras,
        tracks=[known.get(k, found[k]) for k in cameras],
        delay_s=np.array([delay_s[k] for k in cameras]),
        refused=why,
    )


def _sights(tracks: Mapping[int, SpotTrack], a: int, b: int) -> int:
    """Return how often the less seeing of two cameras saw a light that both know."""
    one, other = tracks[a].names, tracks[b].names
    return max((min(one.count(name), other.count(name)) for name in set(one)), default=0)


def _named_like(
    rig: Rig,
    tracks: Mapping[int, SpotTrack],
    known: Mapping[int, SpotTrack],
    times_s: Mapping[int, Array],
    edge: tuple[int, int],
    count: int,
) -> dict[int, SpotTrack]:
    """Return the tracks of both cameras of an edge with the lights named, as the first one's already are.

    Raises NotEnoughData, and as coarse_delay.
    """
    a, b = edge
    cameras = [replace(rig.cameras[k], name=side) for k, side in zip(edge, SIDES, strict=True)]
    one, other = named_by_motion(Rig(cameras=cameras), (tracks[a], tracks[b]), (times_s[a], times_s[b]), count)
    if a not in known:
        return {a: one, b: other}
    before = dict(zip(_spots(known[a]), known[a].names, strict=True))
    # spots of the first camera that both namings know say which of their names are one light's
    votes = np.zeros((count, count))
    for spot, name in zip(_spots(one), one.names, strict=True):
        if spot in before:
            votes[int(name) - 1, int(before[spot]) - 1] += 1.0
    to = scipy.optimize.linear_sum_assignment(-votes)[1]
    return {b: replace(other, names=tuple(str(to[int(name) - 1] + 1) for name in other.names))}


def _spots(track: SpotTrack) -> list[tuple[float, ...]]:
    """Return what tells a camera's spots apart."""
    return [(float(frame), *uv) for frame, uv in zip(track.frame.tolist(), track.uv_px.tolist(), strict=True)]
