"""The page of repeats alone: the figures of ISO 9283, and how the visits lie about their means."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

import numpy as np

from armsight.report.figures import BLUE, GREEN, GREY, ORANGE, RED, Figure, Plot, axis, layout
from armsight.report.html import Card, Page, bullets, table, text
from armsight.report.verify_report import BY_PLACE, ISO_TOLD, LISTED, PRINT, iso_by_place, iso_table
from armsight.units import MM, figure_of
from armsight.verify import Measured, Repeats
from armsight.verify.results import IsoFigure, VerifyOutput

CARD_NAMES: Mapping[str, str] = {
    "RP_m": "RP, repeatability of a pose",
    "RD_m": "RD, repeatability of a distance",
    "vAP_m": "vAP, variation between approaches",
    "RT_m": "RT, repeatability of a path",
}
COLOURS = (BLUE, ORANGE, GREEN, RED, GREY)


def repeats_report(
    measured: Measured,
    repeats: Repeats,
    summary: VerifyOutput,
    *,
    other: tuple[str, VerifyOutput] | None = None,
    created: datetime | None = None,
) -> str:
    """Return the page as HTML text that needs no other file. summary: what verify.json holds; other: the folder and
    the summary of a run to stand beside this one."""
    iso = summary.iso9283
    page = Page(
        title="Repeatability",
        subtitle=f"{summary.n} rows, {len(summary.rejected)} left out",
        verdict=summary.verdict_,
        cards=_cards(iso),
    )
    page.add("ISO 9283", ISO_TOLD, iso_table(iso))
    if other is not None:
        page.add("Beside the other run", f"The other run is {other[0]}. SI units.", _compared(iso, other[1].iso9283))
    if any(repeats.at_pose):
        page.add("Visits about their mean", "Each row less the mean of its pose.", _about(page, measured, repeats))
        text = "Distance of each row from the mean of its pose, in the order of the rows: a drift climbs or falls."
        page.add("Deviation over the rows", text, page.plot(_course(measured, repeats)))
    page.style = PRINT.format(first=4, zoom=0.72)
    if by_place := iso_by_place(iso):
        page.add("ISO 9283 by place", BY_PLACE, by_place)
    if summary.doubts:
        page.add("What to know", "", bullets(summary.doubts))
    if summary.rejected:
        rows = [[item.row, item.why] for item in summary.rejected[:LISTED]]
        page.add("Rows left out", "", table(["row", "why"], rows))
    return page.html(created=created or datetime.now())


def _compared(iso: Mapping[str, IsoFigure], other: Mapping[str, IsoFigure]) -> str:
    """Return the figures that both or one of two runs give, side by side; those of the worst place."""
    rows = []
    for name in (key for key in dict.fromkeys([*iso, *other]) if " " not in key):
        pair = [run.get(name) for run in (other, iso)]
        if any(item is not None and item.value is not None for item in pair):
            shown = [(None, None) if item is None else (item.value, item.std) for item in pair]
            rows.append([name, *(figure_of(value) for one in shown for value in one)])
    return table(["figure", "the other run", "±", "this run", "±"], rows, numbers=(1, 2, 3, 4))


def _cards(iso: Mapping[str, IsoFigure]) -> list[Card]:
    cards = []
    for name in CARD_NAMES:
        item = iso.get(name)
        if item is not None and item.value is not None:
            note = f"{item.n} of {item.wanted} repeats"
            cards.append(Card(name=CARD_NAMES[name], value=f"{item.shown(MM)} mm", note=note))
    return cards


def _course(measured: Measured, repeats: Repeats) -> Figure:
    """Return each row's distance from the mean of its pose, over the rows."""
    pose = np.array(repeats.at_pose)
    data = []
    for k, name in enumerate(sorted(set(pose) - {""})):
        rows = np.flatnonzero(pose == name)
        off = np.linalg.norm(measured.xyz_m[rows] - measured.xyz_m[rows].mean(axis=0), axis=1) / MM
        marker = {"color": COLOURS[k % len(COLOURS)], "size": 5, "symbol": k // len(COLOURS)}
        where = {"x": measured.rows[rows].astype(float), "y": off}
        data.append({"type": "scatter", "mode": "markers", "name": text(name), "marker": marker, **where})
    shape = layout(xaxis=axis("row"), yaxis=axis("distance, mm", rangemode="tozero"))
    return Figure(data=data, layout=shape, height_px=300)


def _about(page: Page, measured: Measured, repeats: Repeats) -> str:
    """Return each visit's row less the mean of its pose, seen from above and from the side."""
    seen = (_side(measured, repeats, 1), _side(measured, repeats, 2))
    return '<div class="pair">' + "".join(map(page.plot, seen)) + "</div>"


def _side(measured: Measured, repeats: Repeats, up: int) -> Figure:
    """Return x and the coordinate up of each visit about the mean of its pose, to one scale."""
    pose = np.array(repeats.at_pose)
    data: list[Plot] = []
    for k, name in enumerate(sorted(set(pose) - {""})):
        about = measured.xyz_m[pose == name]
        about = (about - about.mean(axis=0)) / MM
        marker = {"color": COLOURS[k % len(COLOURS)], "size": 5, "symbol": k // len(COLOURS)}
        where = {"x": about[:, 0], "y": about[:, up]}
        data.append({"type": "scatter", "mode": "markers", "name": text(name), "marker": marker, **where})
    shape = layout(xaxis=axis("x, mm"), yaxis=axis(f"{'xyz'[up]}, mm", scaleanchor="x"))
    return Figure(data=data, layout=shape, height_px=380)
