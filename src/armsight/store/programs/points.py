"""The points of a robot's program, what no program may leave open, and the same as a table."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter

from armsight.errors import Ambiguous, BadFile, Inconsistent, NotEnoughData

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
MOVED = 1e-2
"""Outer axes (mm, deg) that differ by more stand elsewhere."""
NO_AXIS = 8.9e9
"""ABB's 9E9: no such axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One position of a program: line (from 1) and name in it.

    xyz, turn: a pose; joints: joint values; cells as the file has them. tool, frame: by the names that the program has
    for them, '' where it says none. outer: positions of further axes, such as a track.
    """

    line: int
    name: str
    xyz: tuple[str, ...] = ()
    turn: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    tool: str = ""
    frame: str = ""
    outer: tuple[str, ...] = ()


@dataclass(slots=True, kw_only=True)
class Listed:
    """The points of a program in the order of the file, what to know of it, in words, and how many numbers each kind of
    position has."""

    where: str
    points: list[Point] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    def location(self, line: int) -> str:
        """Return 'file, line 7'."""
        return f"{self.where}, line {line}"

    def values(self, line: int, name: str, cells: str, counts: Iterable[int], kind: str) -> tuple[str, ...]:
        """Return the numbers of a position, as many as the others of its kind have. Raises BadFile."""
        found = listed_numbers(cells, self.location(line), name, counts)
        if self.counts.setdefault(kind, len(found)) != len(found):
            raise wrong_count(len(found), self.location(line), name, (self.counts[kind],))
        return found


def line_of(text: str, at: int) -> int:
    """Return the line, from 1, of a place in a text."""
    return text.count("\n", 0, at) + 1


def numbers(cells: Sequence[str], where: str, wanted: str) -> tuple[str, ...]:
    """Return cells that are numbers, as they are written. Raises BadFile that names the cell."""
    out = tuple(cell.strip() for cell in cells)
    for cell in out:
        if NUMBER.fullmatch(cell) is None:
            raise BadFile(f"{where}: {cell[:30]!r} is no number", consequence=f"{wanted} is not known", cure=POINTS)
    return out


POINTS = "Write numbers with a decimal point, one after each comma"


def listed_numbers(text: str, where: str, wanted: str, counts: Iterable[int]) -> tuple[str, ...]:
    """Return the numbers of 'a,b,c'. Raises BadFile for another count: by far where commas are decimal ones."""
    cells, allowed = text.split(","), tuple(counts)
    if len(cells) not in allowed:
        raise wrong_count(len(cells), where, wanted, allowed)
    return numbers(cells, where, wanted)


def wrong_count(found: int, where: str, wanted: str, allowed: Sequence[int]) -> BadFile:
    """Return the refusal of so many numbers where others are allowed."""
    doubled = found > max(allowed)
    hint = "; decimal commas make two of one" if doubled else "; the file may be cut"
    return BadFile(
        f"{where}: {found} numbers for {wanted}, which has {' or '.join(map(str, allowed))}{hint}",
        consequence=f"{wanted[0].upper()}{wanted[1:]} is not known",
        cure=POINTS if doubled else "Export the program again",
    )


def require_end(found: Listed, there: bool, mark: str) -> None:
    """Raise BadFile for a program whose last mark is missing."""
    if not there:
        raise BadFile(
            f"{found.where}: ends without {mark}",
            consequence="It is cut, and how many points are missing is not known",
            cure=f"Export it again; where it is complete, write {mark} as its last line",
        )


def chosen(found: Listed, joints: bool | None) -> tuple[list[Point], str]:
    """Return the points of one kind, and the names of the others; joints: the kind wanted, None for the more frequent.

    Raises NotEnoughData for none.
    """
    of_joints = [point for point in found.points if point.joints]
    poses = [point for point in found.points if not point.joints]
    if joints is None:
        joints = len(of_joints) > len(poses)
    kept, others = (of_joints, poses) if joints else (poses, of_joints)
    if not kept:
        there = f"; its {len(others)} points are {'poses' if joints else 'joint values'}" if others else ""
        raise NotEnoughData(
            f"{found.where}: a program without {'joint values' if joints else 'a pose'}{there}",
            consequence="There is nothing to read",
            cure="Give the file that holds the points: of KUKA the .dat beside the .src",
        )
    return kept, ", ".join(point.name for point in others)


def require_one_kind(found: Listed) -> None:
    """Raise Ambiguous for a program with several poses and several joint values: either may be meant."""
    of_joints = sum(bool(point.joints) for point in found.points)
    if min(of_joints, len(found.points) - of_joints) > 1:
        raise Ambiguous(
            f"{found.where}: {of_joints} points are joint values and {len(found.points) - of_joints} are poses",
            consequence="Which of them are meant is not known",
            cure="Say --as joints or --as poses",
        )


def one_setting(found: Listed, points: Sequence[Point], *, as_stated: bool) -> list[str]:
    """Return what is said of tool and frame of these points.

    Raises Inconsistent for two tools or frames, and for outer axes that stand elsewhere from point to point.
    """
    notes = []
    poses = [point for point in points if not point.joints]
    for what, of in (("tool", attrgetter("tool")), ("frame", attrgetter("frame"))):
        names = {of(point): point for point in reversed(poses)}
        if len(names) > 1:
            told = ", ".join(f"{name or 'none named'} (line {point.line})" for name, point in sorted(names.items()))
            raise Inconsistent(
                f"{found.where}: points of {len(names)} {what}s in one program: {told[:200]}",
                consequence=f"Poses in different {what}s cannot stand in one table",
                cure=f"Leave the points of one {what} in the file, or export them apart",
            )
        if names and (name := next(iter(names))):
            notes.append(f"poses of {what} {name}, as the controller has it")
    if poses and len(notes) < 2:
        notes.append("which tool and frame the poses are of, the program does not say for all")
    _require_still(found, points, as_stated=as_stated)
    return notes


def _require_still(found: Listed, points: Sequence[Point], *, as_stated: bool) -> None:
    values: dict[int, list[float]] = {}
    for point in points:
        for k, cell in enumerate(point.outer):
            if abs(float(cell)) < NO_AXIS:
                values.setdefault(k, []).append(float(cell))
    moving = [k for k, column in values.items() if max(column) - min(column) > MOVED]
    if moving and not as_stated:
        raise Inconsistent(
            f"{found.where}: outer axis {moving[0] + 1} moves from point to point",
            consequence="Where the arm's base stands differs if that axis carries it",
            cure="Leave the points of one position of it in the file; --as-stated if it does not carry the arm",
        )


def about_z(points: Sequence[Point], order: str) -> bool:
    """Whether all points turn about z alone, as those of a SCARA do: the order of their angles is then any."""
    return not any(float(point.turn[k]) for point in points for k in range(3) if order[k] != "z")


def asked_order(found: Listed, kind: str, likely: str) -> Ambiguous:
    """Return the refusal of angles whose order no source settles."""
    return Ambiguous(
        f"{found.where}: in which order the angles of {kind} turn is not settled by a source",
        consequence="The same three angles are other rotations in another order",
        cure=f"Give --euler with the order of the controller's manual: {likely}",
    )
