"""The page of repeats alone: the figures of ISO 9283, and how the visits lie about their means."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.report.figures import BLUE, GREY, ORANGE, Figure, axis, layout, place
from armsight.report.html import Card, Page, Verdict, bullets, figure_of, table
from armsight.report.verify_report import BY_PLACE, ISO_TOLD, LISTED, PRINT, iso_by_place, iso_table
from armsight.units import MM
from armsight.verify import Measured, Repeats

Array = NDArray[np.float64]

COLOURS = (BLUE, ORANGE, GREY)


def repeats_report(
    measured: Measured, repeats: Repeats, summary: Mapping[str, Any], *, created: datetime | None = None
) -> str:
    """Return the page as HTML text that needs no other file. summary: as verify.json holds it."""
    iso = summary["iso9283"]
    given = sum(item["value"] is not None for item in iso.values())
    page = Page(
        title="Repeatability",
        subtitle=f"{summary['n']} rows, {len(summary['rejected'])} left out",
        verdict=Verdict(
            level="good" if given else "warn",
            word=f"{given} figures given" if given else "No figure can be given",
            sentence=summary["verdict"],
        ),
        cards=_cards(iso),
    )
    page.add("ISO 9283", ISO_TOLD, iso_table(iso))
    names = sorted({pose for pose, run in zip(repeats.pose, repeats.run, strict=True) if pose and not run})
    if names:
        page.add("Visits about their mean", "Each row less the mean of its pose.", page.plot(_about(measured, repeats)))
    page.style = PRINT.format(first=3, zoom=0.72)
    if by_place := iso_by_place(iso):
        page.add("ISO 9283 by place", BY_PLACE, by_place)
    if summary["doubts"]:
        page.add("What to know", "", bullets(summary["doubts"]))
    if summary["rejected"]:
        rows = [[item["row"], item["why"]] for item in summary["rejected"][:LISTED]]
        page.add("Rows left out", "", table(["row", "why"], rows))
    return page.html(created=created or datetime.now())


def _cards(iso: Mapping[str, Any]) -> list[Card]:
    cards = []
    for name in ("RP_m", "RD_m", "vAP_m", "RT_m"):
        item = iso.get(name)
        if item is not None and item["value"] is not None:
            note = f"{item['n']} of {item['wanted']} repeats"
            cards.append(Card(name=name[:-2], value=figure_of(item["value"] / MM, "mm"), note=note))
    return cards


def _about(measured: Measured, repeats: Repeats) -> Figure:
    """Return each visit's row less the mean of its pose, seen from above and from the side."""
    pose = np.array([word if not run else "" for word, run in zip(repeats.pose, repeats.run, strict=True)])
    data: list[dict[str, Any]] = []
    for k, name in enumerate(sorted(set(pose) - {""})):
        about = measured.xyz_m[pose == name]
        about = (about - about.mean(axis=0)) / MM
        for panel, up in ((1, 1), (2, 2)):
            data.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": name,
                    "showlegend": panel == 1,
                    "x": about[:, 0],
                    "y": about[:, up],
                    "marker": {"color": COLOURS[k % len(COLOURS)], "size": 5, "symbol": k // len(COLOURS)},
                    **place(panel),
                }
            )
    return Figure(
        data=data,
        layout=layout(
            xaxis=axis("x, mm", domain=[0.0, 0.46]),
            yaxis=axis("y, mm"),
            xaxis2=axis("x, mm", domain=[0.54, 1.0], anchor="y2"),
            yaxis2=axis("z, mm", anchor="x2"),
        ),
        height_px=360,
    )
