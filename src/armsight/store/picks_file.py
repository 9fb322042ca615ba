"""picks.csv: what a person picked in one view of a scene, points and the corners of edges."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.store.atomic import read_bytes
from armsight.store.tables import MAX_BYTES, parse_table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picks:
    """Pixels uv_px (n, 2) in their order; edges (n,): the name of the edge that each is a corner of, empty for none."""

    uv_px: Array
    edges: tuple[str, ...]


def read_picks(path: Path) -> Picks:
    """Return the picks of a file; see parse_picks."""
    return parse_picks(read_bytes(path, limit=MAX_BYTES), str(path))


def parse_picks(data: bytes, where: str) -> Picks:
    """Return the picks in the bytes of a table u_px,v_px[,edge].

    Rows of one edge follow each other. Raises BadFile that names file, line and column; NotEnoughData without a row.
    """
    table = parse_table(data, where, ("u_px", "v_px"), optional=("edge",), text=("edge",))
    edges = table.text.get("edge", ("",) * len(table))
    ended: set[str] = set()
    for row, edge in enumerate(edges):
        if edge and edge in ended:
            raise BadFile(
                f"{table.location(row)}, column edge: {edge[:40]!r} ended further up",
                consequence="The picks are not used",
                cure="Let the rows of an edge follow each other",
            )
        if row + 1 < len(edges) and edges[row + 1] != edge:
            ended.add(edge)
    return Picks(uv_px=table.stacked(("u_px", "v_px")), edges=edges)
