"""Pages of verifications beside verify's own: a supervision, a check after a crash, repeats alone (ISO 9283)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath

import numpy as np

from armsight.arrays import Array
from armsight.report.figures import BLUE, GREEN, GREY, ORANGE, RED, Figure, Plot, axis, layout, subplot, thinned, trace
from armsight.report.html import NOTHING, Card, Given, Page, add_recordings, page_unit, table, text
from armsight.report.verify_report import (
    BY_PLACE,
    ISO_TOLD,
    LISTED,
    PRINT,
    iso_by_place,
    iso_table,
    named_inputs,
    verify_report,
)
from armsight.units import DEG, MM, displayed, figure_of, with_deviation
from armsight.verify import Measured, Repeats
from armsight.verify.iso9283.figure import IsoFigure
from armsight.verify.live import LiveSeries, VerifyLiveOutput
from armsight.verify.results import MasteringOutput, VerifyResult
from armsight.verify.supervision import Limits

COURSE = (
    "Length of the error of place and angle of the error of rotation; dotted: three standard deviations of what "
    "measurement and expectation may be off along it. Gaps: nothing could be compared."
)


def verification(result: VerifyResult, files: Sequence[Path], given: Given) -> str:
    """Return the page of a verification, or of repeats alone."""
    return repeats_report(result) if result.verification is None else verify_report(result, given)


def live_report(summary: VerifyLiveOutput, files: Sequence[Path] = (), given: Given = NOTHING) -> str:
    """Return the page as HTML text that needs no other file."""
    page = Page(
        title="Supervision of a running arm",
        subtitle=f"{summary.n} {'pairs of frames' if summary.of_pair else 'moments'}, {summary.n_compared} compared",
        verdict=summary.verdict_,
        cards=_cards(summary),
    )
    if summary.alarms:
        rows = [[f"{item.t_s:.3f}", item.level, item.why] for item in summary.alarms]
        page.add("Alarms", "", table(["t, s", "level", "why"], rows, numbers=(0,)))
    page.add("Errors over time", COURSE, page.plot(_live_course(summary.log.series(), summary.levels)))
    page.add_notes(summary.doubts)
    add_recordings(page, [PurePath(summary.recording).name] if summary.recording else [])
    cameras = given.get("cameras")
    more = cameras if isinstance(cameras, Mapping) else {}
    devices = ("robot", *dict.fromkeys(("left", "right", *more)), "arm")
    page.add_inputs(named_inputs({**given, **more}, (*devices, "rig", "target", "world"), devices))
    return page.html()


def _cards(summary: VerifyLiveOutput) -> list[Card]:
    errors, ms = summary.errors, summary.decision_ms

    def shown(value: float | None, factor: float, unit: str) -> str:
        return figure_of(None if value is None else value / factor, unit)

    cards = [
        Card("error of place", shown(errors.rms_m, MM, "mm"), f"RMS; noise {shown(errors.std_m, MM, 'mm')}"),
        Card("largest", shown(errors.max_m, MM, "mm")),
        Card("error of rotation", shown(errors.rms_rad, DEG, "°"), f"RMS; noise {shown(errors.std_rad, DEG, '°')}"),
        Card("pairs a second", figure_of(summary.rate_hz), f"{summary.missed} never came"),
        Card("longest blind", figure_of(summary.blind_s, "s")),
    ]
    if ms is not None:
        cards.append(Card("decision", figure_of(ms.median, "ms"), f"p99 {figure_of(ms.p99, 'ms')}"))
    return cards


def _live_course(series: LiveSeries, levels: Limits) -> Figure:
    """Return errors of place and rotation over time, with noise and levels."""
    data: list[Plot] = []
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
    return trace("lines", name, x, y, line=line, showlegend=k == 1, **subplot(k))


ZEROS = "What is believed with the cause told; deviations hold what the links' lengths and axes may be off by."


def mastering_report(summary: MasteringOutput, files: Sequence[Path] = (), given: Given = NOTHING) -> str:
    """Return the page as HTML text that needs no other file."""
    slides = summary.slides
    page = Page(
        title=f"After a crash: {'' if summary.model is None else summary.model.name}",
        subtitle=f"{summary.n} poses compared, {len(summary.rejected)} left out",
        verdict=summary.verdict_,
        cards=[
            Card("error of place", figure_of(summary.rms_before_m / MM, "mm"), "RMS, as measured"),
            Card("without the cause", figure_of(summary.rms_after_m / MM, "mm"), "RMS"),
        ],
    )
    rows = []
    for joint in summary.joints:
        value, std = joint.offset_rad, joint.std_rad
        unit, scale = displayed("m" if joint.index in slides else "rad")
        shown = ("–", "–") if value is None else with_deviation(value / scale, None if std is None else std / scale)
        rows.append([f"{joint.index} {joint.name}", *shown, page_unit(unit), joint.why])
    page.add("Joints", ZEROS, table(["joint", "zero", "±", "unit", ""], rows, numbers=(1, 2)))
    page.add_notes(summary.doubts)
    if summary.rejected:
        page.add("Rows left out", "", table(["row", "why"], [[r.row, r.why] for r in summary.rejected]))
    return page.html()


CARD_NAMES: Mapping[str, str] = {
    "RP_m": "RP, repeatability of a pose",
    "RD_m": "RD, repeatability of a distance",
    "vAP_m": "vAP, variation between approaches",
    "RT_m": "RT, repeatability of a path",
}
COLOURS = (BLUE, ORANGE, GREEN, RED, GREY)


def repeats_report(summary: VerifyResult) -> str:
    """Return the page of repeats alone as HTML text that needs no other file."""
    iso, other = summary.iso9283, summary.earlier
    page = Page(
        title="Repeatability",
        subtitle=f"{summary.n} rows, {len(summary.rejected)} left out",
        verdict=summary.verdict_,
        cards=_iso_cards(iso),
    )
    page.add("ISO 9283", ISO_TOLD, iso_table(iso))
    if other is not None:
        beside = _compared(iso, other.result.iso9283)
        page.add("Beside the other run", f"The other run is {other.name}. SI units.", beside)
    if summary.repeated is not None and any(summary.repeated[1].at_pose):
        measured, repeats = summary.repeated
        page.add("Visits about their mean", "Each row less the mean of its pose.", _about(page, measured, repeats))
        text = "Distance of each row from the mean of its pose, in the order of the rows: a drift climbs or falls."
        page.add("Deviation over the rows", text, page.plot(_course(measured, repeats)))
    page.style = PRINT.format(first=4, zoom=0.72)
    if by_place := iso_by_place(iso):
        page.add("ISO 9283 by place", BY_PLACE, by_place)
    page.add_notes(summary.doubts)
    if summary.rejected:
        rows = [[item.row, item.why] for item in summary.rejected[:LISTED]]
        page.add("Rows left out", "", table(["row", "why"], rows))
    return page.html()


def _compared(iso: Mapping[str, IsoFigure], other: Mapping[str, IsoFigure]) -> str:
    """Return the figures that both or one of two runs give, side by side; those of the worst place."""
    rows = []
    for name in (key for key in dict.fromkeys([*iso, *other]) if " " not in key):
        pair = [run.get(name) for run in (other, iso)]
        if any(item is not None and item.value is not None for item in pair):
            shown = [(None, None) if item is None else (item.value, item.std) for item in pair]
            rows.append([name, *(figure_of(value) for one in shown for value in one)])
    return table(["figure", "the other run", "±", "this run", "±"], rows, numbers=(1, 2, 3, 4))


def _iso_cards(iso: Mapping[str, IsoFigure]) -> list[Card]:
    cards = []
    for name in CARD_NAMES:
        item = iso.get(name)
        if item is not None and item.value is not None:
            note = f"{item.n} of {item.wanted} repeats"
            cards.append(Card(CARD_NAMES[name], f"{item.shown(MM)} mm", note))
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
