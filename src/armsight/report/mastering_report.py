"""The page of a check after a crash: verdict, figures, the joints' zeros."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime

from armsight.report.html import Card, Page, bullets, page_unit, table
from armsight.units import MM, displayed, figure_of, with_deviation
from armsight.verify.results import MasteringOutput

ZEROS = "What is believed with the cause told; deviations hold what the links' lengths and axes may be off by."


def mastering_report(
    summary: MasteringOutput, name: str, *, slides: Collection[int] = (), created: datetime | None = None
) -> str:
    """Return the page as HTML text that needs no other file. summary: what verify.json holds; slides: the indices,
    from 1, of joints that slide."""
    page = Page(
        title=f"After a crash: {name}",
        subtitle=f"{summary.n} poses compared, {len(summary.rejected)} left out",
        verdict=summary.verdict_,
        cards=[
            Card(name="error of place", value=figure_of(summary.rms_before_m / MM, "mm"), note="RMS, as measured"),
            Card(name="without the cause", value=figure_of(summary.rms_after_m / MM, "mm"), note="RMS"),
        ],
    )
    rows = []
    for joint in summary.joints:
        value, std = joint.offset_rad, joint.std_rad
        unit, scale = displayed("m" if joint.index in slides else "rad")
        shown = ("–", "–") if value is None else with_deviation(value / scale, None if std is None else std / scale)
        rows.append([f"{joint.index} {joint.name}", *shown, page_unit(unit), joint.why])
    page.add("Joints", ZEROS, table(["joint", "zero", "±", "unit", ""], rows, numbers=(1, 2)))
    if summary.doubts:
        page.add("What to know", "", bullets(summary.doubts))
    if summary.rejected:
        page.add("Rows left out", "", table(["row", "why"], [[r.row, r.why] for r in summary.rejected]))
    return page.html(created=created or datetime.now())
