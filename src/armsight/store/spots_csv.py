"""Pixels: of one camera over time (t_s,u_px,v_px[,su_px,sv_px][,spot]), or as a person picked them (picks.csv)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.records.views import SpotTrack
from armsight.store.atomic import read_bytes
from armsight.store.codec import LARGEST
from armsight.store.tables import MAX_BYTES, Table, parse_table

REQUIRED = ("t_s", "u_px", "v_px")
DEVIATIONS = ("su_px", "sv_px")
STD_PX = 0.1
"""Where a file says nothing of its spots' standard deviations."""
SMALLEST_PX = 1e-9
"""A standard deviation below this is none."""
UNUSED = "The file is not used"


def read_spot_track(path: Path) -> SpotTrack:
    """Return the spots in a file; see parse_spot_track."""
    return parse_spot_track(read_bytes(path, limit=MAX_BYTES), str(path))


def parse_spot_track(data: bytes, where: str) -> SpotTrack:
    """Return the spots in the bytes of a table t_s,u_px,v_px[,su_px,sv_px][,spot]; rows of equal t_s are one frame.

    Raises BadFile that names file, line and column, NotEnoughData where there is no row.
    """
    table = parse_table(data, where, REQUIRED, optional=(*DEVIATIONS, "spot"), text=("spot",))
    t = table.numbers["t_s"]
    _require_sizes(table)
    back = np.flatnonzero(np.diff(t) < 0.0)
    if len(back):
        raise BadFile(
            f"{table.location(int(back[0]) + 1)}, column t_s: the time goes back, or a frame stands in two places",
            cure="Give the frames in the order of time, and the spots of a frame in rows of the same t_s",
        )
    frames, frame = np.unique(t, return_inverse=True)
    names = table.text.get("spot", ("",) * len(table))
    _require_once(table, frame, names)
    std = table.stacked(DEVIATIONS) if DEVIATIONS[0] in table.numbers else np.full((len(table), 2), STD_PX)
    return SpotTrack(
        t_s=frames,
        frame=frame.astype(np.intp),
        names=names,
        uv_px=table.stacked(("u_px", "v_px")),
        covariance_px2=std[:, :, None] ** 2 * np.eye(2),
    )


def _require_sizes(table: Table) -> None:
    """Raise BadFile where a number cannot be what its column says."""
    given = [name for name in DEVIATIONS if name in table.numbers]
    if len(given) == 1:
        missing = next(name for name in DEVIATIONS if name not in given)
        raise BadFile(
            f"{table.where}: the column {given[0]} stands without {missing}",
            cure="Give the standard deviations along both axes, or none",
        )
    for name in (*REQUIRED, *given):
        values = table.numbers[name]
        wrong = np.abs(values) > LARGEST
        what = f"larger than {LARGEST:g}"
        if name in DEVIATIONS:
            wrong, what = wrong | (values < SMALLEST_PX), "no standard deviation"
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise BadFile(
                f"{table.location(row)}, column {name}: {values[row]:g} is {what}", cure="Correct it, or remove the row"
            )


def _require_once(table: Table, frame: NDArray[np.intp], names: tuple[str, ...]) -> None:
    """Raise BadFile where a light stands twice in a frame, or has a name in some rows only."""
    seen: set[tuple[int, str]] = set()
    for row, (k, name) in enumerate(zip(frame.tolist(), names, strict=True)):
        if not name and "spot" in table.text:
            raise BadFile(
                f"{table.location(row)}, column spot: empty", cure="Name every spot, or leave the column away"
            )
        if name and (k, name) in seen:
            raise BadFile(
                f"{table.location(row)}, column spot: {name[:40]!r} stands twice at this t_s",
                cure="Give each light of a frame once; frames that follow each other need different times",
            )
        seen.add((k, name))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picks:
    """Pixels uv_px (n, 2) in their order; edges (n,): the name of the edge that each is a corner of, empty for none."""

    uv_px: Array
    edges: tuple[str, ...]


def read_picks(path: Path) -> Picks:
    """Return the picks of a file; see parse_picks."""
    return parse_picks(read_bytes(path, limit=MAX_BYTES), str(path))


def parse_picks(data: bytes, where: str) -> Picks:
    """Return the picks of u_px,v_px[,edge], an edge's rows together. Raises BadFile, with the cell, NotEnoughData."""
    table = parse_table(data, where, ("u_px", "v_px"), optional=("edge",), text=("edge",))
    edges = table.text.get("edge", ("",) * len(table))
    ended: set[str] = set()
    for row, edge in enumerate(edges):
        if edge and edge in ended:
            raise BadFile(
                f"{table.location(row)}, column edge: {edge[:40]!r} ended further up",
                cure="Let the rows of an edge follow each other",
            )
        if row + 1 < len(edges) and edges[row + 1] != edge:
            ended.add(edge)
    return Picks(uv_px=table.stacked(("u_px", "v_px")), edges=edges)
