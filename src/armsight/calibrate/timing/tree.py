"""Which cameras the lights tie to a rig's first one, how late each of them is, and which spot is which light."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its optimize where it is used

from armsight.arrays import Array
from armsight.calibrate.timing.coarse import coarse_delay
from armsight.calibrate.timing.naming import lights_named, named_by_motion
from armsight.calibrate.timing.views import common_lights
from armsight.errors import DataRefused
from armsight.optics import SIDES, Rig
from armsight.records import SpotTrack


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
            late = coarse_delay(pair, both, (times_s[a], times_s[b]), common_lights(*both)[0]).delay_s
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
