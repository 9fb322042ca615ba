"""touch.csv: joint readings while a tip rested on what has a name: spikes, flats, balls, dial gauges."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from armsight.calibrate.arm.touch import KnownLength, Touches
from armsight.calibrate.arm.touch.touches import Kind
from armsight.columns import POSITION
from armsight.defaults import TOUCH_LENGTH_STD_M
from armsight.errors import BadFile
from armsight.store.interpret import OURS, TableFormat
from armsight.store.interpret.read import joint_readings
from armsight.store.tables import Table, read_table

FEATURE, KIND, TIP, READING, SIGMA = "feature", "kind", "tip", "reading_m", "sigma_m"


def read_touches(path: Path, format_: TableFormat = OURS) -> Touches:
    """Return the touches of q1..qn,feature[,kind][,tip][,reading_m][,sigma_m]; without kind they are of points.

    Without `feature`, x_m,y_m,z_m tell the points apart, named 1, 2 .. as they come, and their distances are known
    lengths. Raises BadFile that names line and column.
    """
    table = read_table(
        path,
        (),
        optional=(FEATURE, KIND, TIP, READING, SIGMA, *POSITION),
        text=(FEATURE, KIND, TIP),
        blank=(READING, SIGMA),
        series="q",
    )
    q = joint_readings(table, str(path), format_)
    kinds = tuple(_kind(table, row) for row in range(len(table)))
    feature, lengths = (table.text[FEATURE], ()) if FEATURE in table.text else _of_places(table)
    tip = table.text.get(TIP, ())
    for row, name in enumerate(feature):
        if not name:
            raise BadFile(f"{table.location(row)}, column {FEATURE}: empty", cure="Name what the row touched")
        if any(tip) and not tip[row]:
            raise BadFile(
                f"{table.location(row)}, column {TIP}: empty, and other rows name theirs",
                cure="Name the tip in every row, or in none where it was one",
            )
    return Touches(
        q=q,
        feature=feature,
        kind=kinds,
        reading_m=_readings(table, kinds),
        sigma_m=np.nan_to_num(table.numbers.get(SIGMA, np.zeros(len(table)))),
        lengths=lengths,
        row=np.arange(len(table)),
        tip=tip,
    )


def _kind(table: Table, row: int) -> Kind:
    text = table.text[KIND][row].lower() if KIND in table.text else Kind.POINT
    if text not in set(Kind):
        raise BadFile(
            f"{table.location(row)}, column {KIND}: {text!r} is no kind", cure=f"Write one of: {', '.join(Kind)}"
        )
    return Kind(text)


def _readings(table: Table, kinds: tuple[Kind, ...]) -> np.ndarray:
    """Return the readings (m,), 0 of what is no gauge. Raises BadFile for one that lacks or does not belong there."""
    given = table.numbers.get(READING, np.full(len(table), np.nan))
    for row, kind in enumerate(kinds):
        if (kind is Kind.GAUGE) == bool(np.isnan(given[row])):
            lacks = "a gauge needs its reading" if kind is Kind.GAUGE else f"a {kind} has no reading"
            raise BadFile(
                f"{table.location(row)}, column {READING}: {lacks}",
                cure="Write what the gauge showed, in m, and leave the cell empty for all else",
            )
    return np.nan_to_num(given)


def _of_places(table: Table) -> tuple[tuple[str, ...], tuple[KnownLength, ...]]:
    """Return names of the points and the known lengths between them, by the places in the rows."""
    if not all(name in table.numbers for name in POSITION):
        raise BadFile(
            f"{table.where}: no column {FEATURE}",
            consequence="Nobody knows what each row touched",
            cure="Give in every row the name of the spike, flat, ball or gauge",
        )
    xyz = table.stacked(POSITION)
    _, first, which = np.unique(xyz, axis=0, return_index=True, return_inverse=True)
    which = which.ravel()
    rank = np.empty(len(first), dtype=np.intp)
    rank[np.argsort(first)] = np.arange(len(first))
    if len(first) > len(table) / 3:
        raise BadFile(
            f"{table.where}: {len(first)} places in {len(table)} rows",
            consequence="These are measured positions, not touches of a few points",
            cure=f"Give them with --points; or name what was touched in a column {FEATURE}",
        )
    place = xyz[np.sort(first)]
    pairs = [(i, k) for k in range(len(place)) for i in range(k)]
    lengths = [
        KnownLength(
            a=str(i + 1),
            b=str(k + 1),
            length_m=float(np.linalg.norm(place[i] - place[k])),
            sigma_m=TOUCH_LENGTH_STD_M,
        )
        for i, k in pairs
    ]
    return tuple(str(rank[k] + 1) for k in which), tuple(lengths)
