"""The spots of one camera over time: t_s,u_px,v_px[,su_px,sv_px][,spot], one row for each spot of each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadFile
from armsight.records.views import SpotTrack
from armsight.store.atomic import read_bytes
from armsight.store.codec import LARGEST
from armsight.store.tables import MAX_BYTES, Table, cells, number, parse_table, word

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
            consequence=UNUSED,
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


def write_spot_track_text(track: SpotTrack) -> str:
    """Return the spots as the text of such a table."""
    std = np.sqrt(np.diagonal(track.covariance_px2, axis1=1, axis2=2))
    rows = (
        f"{number(track.t_s[k])},{cells(uv)},{cells(s)},{word(name)}"
        for k, uv, s, name in zip(track.frame, track.uv_px, std, track.names, strict=True)
    )
    return "\n".join([",".join((*REQUIRED, *DEVIATIONS, "spot")), *rows]) + "\n"


def _require_sizes(table: Table) -> None:
    """Raise BadFile where a number cannot be what its column says."""
    given = [name for name in DEVIATIONS if name in table.numbers]
    if len(given) == 1:
        missing = next(name for name in DEVIATIONS if name not in given)
        raise BadFile(
            f"{table.where}: the column {given[0]} stands without {missing}",
            consequence=UNUSED,
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
                f"{table.location(row)}, column {name}: {values[row]:g} is {what}",
                consequence=UNUSED,
                cure="Correct the cell, or remove the row",
            )


def _require_once(table: Table, frame: NDArray[np.intp], names: tuple[str, ...]) -> None:
    """Raise BadFile where a light stands twice in a frame, or has a name in some rows only."""
    seen: set[tuple[int, str]] = set()
    for row, (k, name) in enumerate(zip(frame.tolist(), names, strict=True)):
        if not name and "spot" in table.text:
            raise BadFile(
                f"{table.location(row)}, column spot: empty",
                consequence=UNUSED,
                cure="Name every spot, or leave the column away",
            )
        if name and (k, name) in seen:
            raise BadFile(
                f"{table.location(row)}, column spot: {name[:40]!r} stands twice at this t_s",
                consequence=UNUSED,
                cure="Give each light of a frame once; frames that follow each other need different times",
            )
        seen.add((k, name))
