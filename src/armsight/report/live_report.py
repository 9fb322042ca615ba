"""The page of a supervision: verdict, figures, alarms, and the errors over time beside what noise explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import PurePath

import numpy as np

from armsight.arrays import Array
from armsight.report.figures import BLUE, ORANGE, RED, Figure, Plot, axis, layout, subplot, thinned
from armsight.report.html import Card, Page, add_recordings, bullets, table
from armsight.units import DEG, MM, figure_of
from armsight.verify.results import VerifyLiveOutput

COURSE = (
    "Length of the error of place and angle of the error of rotation; dotted: three standard deviations of what "
    "measurement and expectation may be off along it. Gaps: nothing could be compared."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LiveSeries:
    """Rows over time t_s (m,): error (m, 6) in m and rad, std (m, 2) along it; NaN where nothing was compared."""

    t_s: Array
    error: Array
    std: Array

    @property
    def place_m(self) -> Array:
        """Length of the error of place (m,)."""
        return np.asarray(np.linalg.norm(self.error[:, :3], axis=1))

    @property
    def turn_rad(self) -> Array:
        """Angle of the error of rotation (m,)."""
        return np.asarray(np.linalg.norm(self.error[:, 3:], axis=1))


def live_report(
    series: LiveSeries,
    summary: VerifyLiveOutput,
    *,
    inputs: Sequence[tuple[str, str]] = (),
    created: datetime | None = None,
) -> str:
    """Return the page as HTML text that needs no other file. summary: what verify.json holds."""
    page = Page(
        title="Supervision of a running arm",
        subtitle=f"{summary.n} pairs of frames, {summary.n_compared} compared",
        verdict=summary.verdict_,
        cards=_cards(summary),
    )
    if summary.alarms:
        rows = [[f"{item.t_s:.3f}", item.level, item.why] for item in summary.alarms]
        page.add("Alarms", "", table(["t, s", "level", "why"], rows, numbers=(0,)))
    page.add("Errors over time", COURSE, page.plot(live_course(series, summary)))
    if summary.doubts:
        page.add("What to know", "", bullets(summary.doubts))
    add_recordings(page, [PurePath(summary.recording).name] if summary.recording else [])
    if inputs:
        page.add("What went in", "", table(["", ""], [list(item) for item in inputs]))
    return page.html(created=created or datetime.now())


def _cards(summary: VerifyLiveOutput) -> list[Card]:
    errors, ms = summary.errors, summary.decision_ms

    def shown(value: float | None, factor: float, unit: str) -> str:
        return figure_of(None if value is None else value / factor, unit)

    cards = [
        Card(
            name="error of place",
            value=shown(errors.rms_m, MM, "mm"),
            note=f"RMS; noise {shown(errors.std_m, MM, 'mm')}",
        ),
        Card(name="largest", value=shown(errors.max_m, MM, "mm")),
        Card(
            name="error of rotation",
            value=shown(errors.rms_rad, DEG, "°"),
            note=f"RMS; noise {shown(errors.std_rad, DEG, '°')}",
        ),
        Card(name="pairs a second", value=figure_of(summary.rate_hz), note=f"{summary.missed} never came"),
        Card(name="longest blind", value=figure_of(summary.blind_s, "s")),
    ]
    if ms is not None:
        cards.append(Card(name="decision", value=figure_of(ms.median, "ms"), note=f"p99 {figure_of(ms.p99, 'ms')}"))
    return cards


def live_course(series: LiveSeries, summary: VerifyLiveOutput) -> Figure:
    """Return errors of place and rotation over time, with noise and levels."""
    data: list[Plot] = []
    levels = summary.levels
    courses = (
        (series.place_m, MM, levels.warn_m, levels.stop_m),
        (series.turn_rad, DEG, levels.warn_rad, levels.stop_rad),
    )
    for k, (size, factor, warn, stop) in enumerate(courses, start=1):
        shown = thinned(size)
        x, noise = series.t_s[shown], 3.0 * series.std[shown, k - 1]
        lines = [(size[shown], "error", BLUE, "solid"), (noise, "noise, 3 sigma", BLUE, "dot")]
        for y, name, colour, dash in lines:
            data.append(_line(x, y / factor, name, colour, dash, k))
        for level, limit, colour in (("warn", warn, ORANGE), ("stop", stop, RED)):
            if limit is not None and len(x):
                data.append(_line(x[[0, -1]], np.full(2, limit / factor), f"{level} level", colour, "dash", k))
    return Figure(
        data=data,
        layout=layout(
            xaxis=axis("t, s", anchor="y"),
            yaxis=axis("place, mm", domain=[0.56, 1.0], rangemode="tozero"),
            xaxis2=axis("t, s", anchor="y2", matches="x"),
            yaxis2=axis("rotation, °", domain=[0.0, 0.42], rangemode="tozero"),
        ),
        height_px=560,
    )


def _line(x: Array, y: Array, name: str, colour: str, dash: str, k: int) -> Plot:
    line = {"color": colour, "width": 1.5, "dash": dash}
    shape = {"type": "scatter", "mode": "lines", "name": name, "x": x, "y": y, "line": line}
    return {**shape, "showlegend": k == 1, **subplot(k)}
