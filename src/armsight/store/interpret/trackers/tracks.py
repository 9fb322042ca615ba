"""What a tracker's file says: bodies and markers over time, and which of them is meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from armsight.arrays import Array
from armsight.columns import POSITION, QUATERNION
from armsight.errors import Ambiguous, Inconsistent, NotEnoughData, UsageError
from armsight.store.interpret.raw import RawTable
from armsight.store.interpret.table_format import UNITS, TableFormat
from armsight.store.interpret.trackers.clouds import Cloud, body_of_cloud

MOST_NAMED = 24
"""More names are not listed in a refusal."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """A body or a marker: xyz_m (n, 3) in the tracker's axes; quat_xyzw (n, 4) of T_tracker_body, None of a marker;
    both NaN where it is lost."""

    name: str
    xyz_m: Array
    quat_xyzw: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks:
    """A tracker's file. how: its program and version, in words. lines: (n,) of the file. t_s: (n,), None where there
    are no times. bodies: with poses. markers: points alone; those that belong together are named 'group:marker'."""

    where: str
    how: str
    lines: Sequence[int]
    t_s: Array | None
    bodies: tuple[Track, ...] = ()
    markers: tuple[Track, ...] = ()
    notes: tuple[str, ...] = ()

    def table(self, format_: TableFormat) -> RawTable:
        """Return the body asked for, or the only one, as a table of our columns. Raises UsageError, DataRefused."""
        track, notes = self._chosen(format_.body)
        columns: dict[str, Array] = {} if self.t_s is None else {"t_s": self.t_s}
        columns |= dict(zip(POSITION, track.xyz_m.T, strict=True))
        if track.quat_xyzw is not None:
            columns |= dict(zip(QUATERNION, track.quat_xyzw.T, strict=True))
        cells = tuple(
            ["" if value != value else repr(value) for value in column.tolist()] for column in columns.values()
        )
        return RawTable(
            where=self.where,
            how=f"{self.how}, {track.name}",
            names=tuple(columns),
            columns=cells,
            lines=tuple(self.lines),
            notes=(*self.notes, *notes),
            tracked=True,
        )

    def _chosen(self, wanted: str) -> tuple[Track, tuple[str, ...]]:
        if not self.bodies and not self.markers:
            raise NotEnoughData(f"{self.where}: holds no body and no marker", consequence="There is nothing to do")
        if wanted:
            return self._named(wanted)
        if len(self.bodies) == 1:
            return self._of_name(self.bodies, self.bodies[0].name), self._beside()
        if self.bodies or len(self.groups) > 1:
            raise Ambiguous(
                f"{self.where}: holds {self._listed()}",
                consequence="It is open which is meant",
                cure="Name it with --body",
            )
        return self._cloud(self.markers)

    @property
    def groups(self) -> tuple[str, ...]:
        """The names before the colon of the markers' names, '' for those without."""
        return tuple(dict.fromkeys(marker.name.rpartition(":")[0] for marker in self.markers))

    def _named(self, wanted: str) -> tuple[Track, tuple[str, ...]]:
        if any(body.name == wanted for body in self.bodies):
            return self._of_name(self.bodies, wanted), self._beside()
        if wanted in self.groups:
            return self._cloud([one for one in self.markers if one.name.rpartition(":")[0] == wanted])
        found: dict[str, Track] = {}
        for part in (part.strip() for part in wanted.split(",")):
            names = [one.name for one in self.markers if one.name == part]
            names = names or [one.name for one in self.markers if fnmatchcase(one.name, part)]
            if not names:
                raise UsageError(
                    f"{self.where}: there is no {part!r}; there are {self._listed()}",
                    cure="Give --body with one of these, or the markers of a body with commas between them",
                )
            found |= {name: self._of_name(self.markers, name) for name in names}
        return self._cloud(list(found.values()))

    def _of_name(self, among: Sequence[Track], name: str) -> Track:
        named = [one for one in among if one.name == name]
        if len(named) > 1:
            raise Ambiguous(
                f"{self.where}: {len(named)} are called {name!r}",
                consequence="It is open which is meant",
                cure="Rename one in the tracker's program, and export anew",
            )
        return named[0]

    def _cloud(self, markers: Sequence[Track]) -> tuple[Track, tuple[str, ...]]:
        named = [self._of_name(self.markers, marker.name) for marker in markers]
        if len(named) == 1:
            return named[0], (f"{named[0].name} is one marker: its position alone is used",)
        cloud = Cloud(names=tuple(one.name for one in named), xyz_m=np.stack([one.xyz_m for one in named], axis=1))
        done = body_of_cloud(cloud, self.where)
        return Track(name="a body of markers", xyz_m=done.xyz_m, quat_xyzw=done.quat_xyzw), done.notes

    def _beside(self) -> tuple[str, ...]:
        return (f"the file holds {self._listed()}",) if len(self.bodies) + len(self.markers) > 1 else ()

    def _listed(self) -> str:
        parts = []
        groups = [name for name in self.groups if name]
        for what, names in (
            ("the bodies", [body.name for body in self.bodies]),
            ("the groups of markers", groups),
            ("the markers", [marker.name for marker in self.markers]),
        ):
            if names:
                more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
                parts.append(f"{what} {', '.join(names[:MOST_NAMED])}{more}")
        return "; ".join(parts)


def length_of(unit: str, where: str, format_: TableFormat, what: str) -> float:
    """Return the length of a unit that a file names in m; where it names none, of the one that is said.

    Raises UsageError without either, Inconsistent for one that is no length.
    """
    name = unit.strip().lower()
    if not name and not format_.units:
        raise UsageError(
            f"{where}: {what} says no unit of length",
            consequence="Millimetres and metres cannot be distinguished",
            cure="Give --units mm, or what it is",
        )
    if not name:
        return format_.length_m
    quantity, scale = UNITS.get(name, ("", 0.0))
    if quantity != "length":
        raise Inconsistent(f"{where}: {what} says the unit {unit.strip()[:40]!r}, which is no unit of length")
    return scale
