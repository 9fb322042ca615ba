"""The page of a verification: verdict, figures, the arm with arrows of error, errors over time and joint angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from armsight._files import arm_source
from armsight.arrays import Array
from armsight.geometry import xyz_quat
from armsight.kinematics import Arm
from armsight.report.arm_view import arm_figure
from armsight.report.figures import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Figure,
    Plot,
    axis,
    bars,
    layout,
    spread,
    subplot,
    thinned,
    trace,
)
from armsight.report.html import Card, Given, Page, bullets, page_unit, table, text
from armsight.units import DEG, MM, MS, displayed_name, figure_of, pair_of, with_deviation
from armsight.verify import Verification
from armsight.verify.iso9283.figure import IsoFigure, symbol_of
from armsight.verify.pairing import bare_arm
from armsight.verify.results import VerifyResult

PRINT = """@page{{size:A4;margin:12mm}}
@media print{{section:nth-of-type(n+{first}){{display:none}}main{{zoom:{zoom}}}.verdict{{font-size:15px}}
.cards{{grid-template-columns:repeat(6,1fr)}}th,td{{padding:3px 8px}}section{{margin:6px 0;padding:8px 0}}}}"""
"""On paper: verdict, figures, tables and the errors' course, on one page; pictures in space stay on the screen."""
JOINTS = "Errors carried into the joints by inverse kinematics near the readings; zeros where these poses tell them."
ARROWS_TOLD = "Arrows point from where the tool should be to where it was measured, much enlarged. Drag to turn."
JOINTWISE = "A gear's fault repeats with its joint."
COMPONENTS = (("", ""), ("x", "a"), ("y", "b"), ("z", "c"))
"""A figure's parts as columns: its own, then along and about each axis."""
FIGURES: Mapping[str, str] = {
    "AP": "accuracy of a pose: the mean of the visits less what was commanded",
    "RP": "repeatability of a pose: distance from the mean, mean and three standard deviations",
    "vAP": "variation of accuracy between directions of approach",
    "dAP": "drift of accuracy, from the first visits of a pose to the last",
    "dRP": "drift of repeatability, from the first visits of a pose to the last",
    "AD": "accuracy of a distance",
    "RD": "repeatability of a distance",
    "AT": "accuracy of a path",
    "RT": "repeatability of a path",
    "CR": "rounding of a corner",
    "CO": "overshoot at a corner",
    "AV": "accuracy of the speed",
    "RV": "repeatability of the speed",
    "FV": "fluctuation of the speed",
    "t": "time to come to rest",
    "OV": "overshoot at a pose",
    "E": "exchangeability of robots",
}
"""What the norm's symbols mean."""
ISO_TOLD = "The worst place of each figure, ± its own standard deviation."
BY_PLACE = "Robot alone: without the measurement's scatter, and with what few repeats leave out."
BASE = "base, in the measurements' axes"
TOOL = "tool, in the flange's axes"
ARROWS = 400
ARROW_SHARE = 0.08
"""Length of the longest arrow as a share of the space that the tool moved in."""
LISTED = 40
HISTOGRAM_BARS = 40


def named_inputs(given: Given, names: Sequence[str], in_full: Sequence[str]) -> list[tuple[str, str]]:
    """Return what went in by name where it was said in words: files by their names alone but for those in full."""
    told = [(name, given.get(name)) for name in names]
    texts = [(name, str(value)) for name, value in told if isinstance(value, str | PathLike)]
    return [(name, text if name in in_full else Path(text).name) for name, text in texts]


def verify_report(summary: VerifyResult, given: Given) -> str:
    """Return the page as HTML text that needs no other file; of what was compared with an arm or with commands."""
    result, arm, other = summary.verification, summary.model, summary.earlier
    if result is None:
        raise ValueError("repeats alone have a page of their own")
    page = Page(
        title="Verification" if arm is None else f"Verification of {arm.name}",
        subtitle=f"{summary.n} rows compared, {len(summary.rejected)} left out",
        verdict=summary.verdict_,
        cards=_cards(summary),
    )
    page.add("Errors of the tool", "Measured minus expected, in the base's axes.", _task_table(summary))
    if summary.joints:
        page.add("Joints", JOINTS, _joint_table(summary))
    iso = summary.iso9283
    shown = any(item.n for item in iso.values())
    if shown:
        page.add("ISO 9283", ISO_TOLD, iso_table(iso))
    page.add("Errors over time" if result.paired.at_s is not None else "Errors by row", "", page.plot(course(result)))
    page.style = PRINT.format(first=4 + shown - (not summary.joints), zoom=0.52 if shown else 0.72)
    if other is not None and other.error_m is not None:
        compared = _compared(page, result, summary, other.result, other.error_m)
        page.add("Beside the other run", f"The other run is {other.name}.", compared)
    if arm is not None and result.paired.q is not None:
        page.add("The arm", ARROWS_TOLD, page.plot(arrows(result, arm)))
        page.add("Errors over joint angles", JOINTWISE, page.plot(over_joints(result, arm)))
    if by_place := iso_by_place(iso):
        page.add("ISO 9283 by place", BY_PLACE, by_place)
    _add_background(page, summary, given)
    return page.html()


def _add_background(page: Page, summary: VerifyResult, given: Given) -> None:
    """Add what the figures rest on: base and tool, what to know, rows left out, files."""
    page.add("Base and tool", "", _alignment_table(summary))
    page.add_notes(summary.doubts)
    if summary.rejected:
        rows = [[item.row, item.why] for item in summary.rejected[:LISTED]]
        more = len(summary.rejected) - LISTED
        page.add("Rows left out", f"And {more} more in verify.json." if more > 0 else "", table(["row", "why"], rows))
    arm = given.get("arm")
    if isinstance(arm, str | PathLike):
        links = {name: str(given[name]) for name in ("tip", "base") if given.get(name) is not None}
        given = {**given, "arm": arm_source(str(arm), **links)}
    page.add_inputs(named_inputs(given, ("measured", "arm", "joints", "commanded", "world"), ("arm",)))


def _cards(summary: VerifyResult) -> list[Card]:
    after, before, time = summary.after, summary.before, summary.time
    if after is None or before is None:
        return []  # of repeats alone
    own = [std for k in "xyz" if (std := summary.measurement_std.get(f"{k}_m")) is not None]
    text = (
        "" if len(own) < 3 else f"; the measurement's own {figure_of(float(np.linalg.norm(own)) / MM, 'mm', digits=2)}"
    )
    cards = [
        Card("error of place", figure_of(after.rms_m / MM, "mm"), f"RMS{text}"),
        Card("largest", figure_of(after.max_m / MM, "mm")),
    ]
    if after.rms_rad is not None:
        cards.append(Card("error of rotation", figure_of(after.rms_rad / DEG, "°"), "RMS"))
    free = " and ".join(summary.alignment.free)
    if free:
        cards.append(Card("before aligning", figure_of(before.rms_m / MM, "mm"), f"aligned: {free}"))
    if time.offset_s is not None and time.std_s is not None:
        shown, deviation = with_deviation(time.offset_s / MS, time.std_s / MS)
        cards.append(Card("time offset", f"{shown} ms", f"± {deviation} ms"))
    share = summary.explained.measurement
    if share is not None:
        cards.append(Card("measurement explains", figure_of(100.0 * share, "%"), "of the squared error"))
    return cards


def _task_table(summary: VerifyResult) -> str:
    rows = []
    for name, figures in summary.task.items():
        stem, unit, factor = displayed_name(name)
        std = summary.measurement_std.get(name)
        shown = [figure_of(x / factor) for x in (figures.me, figures.mae, figures.max, figures.sd, figures.rms)]
        rows.append([f"{stem}, {page_unit(unit)}", *shown, figure_of(None if std is None else std / factor)])
    header = ["", "mean", "mean absolute", "largest", "standard deviation", "RMS", "measurement's own ±"]
    return table(header, rows, numbers=range(1, len(header)))


def _joint_table(summary: VerifyResult) -> str:
    rows = []
    for joint in summary.joints:
        shown = [_degrees(x) for x in (joint.me, joint.mae, joint.max, joint.sd, joint.measurement_std)]
        shown += pair_of(*(None if x is None else x / DEG for x in (joint.offset_rad, joint.std_rad)))
        gain = figure_of(None if joint.gain_heldout is None else 100.0 * joint.gain_heldout, "%")
        rows.append([f"{joint.index} {joint.name}", *shown, gain, joint.why or (joint.kind or "")])
    header = [
        "joint",
        "mean, °",
        "mean absolute",
        "largest",
        "standard deviation",
        "measurement's own ±",
        "zero, °",
        "±",
        "alone explains",
        "",
    ]
    return table(header, rows, numbers=range(1, len(header) - 1))


def _degrees(value: float | None) -> str:
    return figure_of(None if value is None else value / DEG)


def iso_table(figures: Mapping[str, IsoFigure]) -> str:
    """Return the worst of each figure, one line for its components, and those withheld by their reason."""
    lines: dict[str, dict[str, str]] = {}
    notes: dict[str, str] = {}
    why: dict[str, list[str]] = {}
    for name, item in figures.items():
        if " " in name:
            continue
        symbol, unit, factor = symbol_of(name)
        family, _, part = symbol.partition("_")
        if item.value is None:
            why.setdefault(item.withheld or "", []).append(symbol)
            continue
        line = lines.setdefault(f"{family}, {unit}", {"repeats": _repeats(item)})
        line[part] = item.shown(factor)
        if item.note and not part:
            notes.setdefault(item.note, family)
    header = ["figure", "value", "x, or about x", "y, or about y", "z, or about z", "repeats"]
    rows = [
        [name, *(line.get(one, line.get(other, "")) for one, other in COMPONENTS), line["repeats"]]
        for name, line in lines.items()
    ]
    parts = [table(header, rows, numbers=range(1, len(header)))] if rows else []
    families = dict.fromkeys(line.partition(",")[0] for line in lines)
    notes_shown = [f"{family}: {FIGURES[family]}" for family in families if family in FIGURES]
    notes_shown += [f"{family}: {text}" for text, family in notes.items()]
    if notes_shown:
        parts.append(bullets(notes_shown))
    if why:
        parts.append("<p>Withheld:</p>" + bullets([f"{', '.join(names)}: {text}" for text, names in why.items()]))
    return "".join(parts)


def iso_by_place(figures: Mapping[str, IsoFigure]) -> str:
    """Return all figures given of single places; empty where there is one place only. A note is told once."""
    rows = []
    notes: dict[str, str] = {}
    for name, item in figures.items():
        key, _, where = name.partition(" ")
        if item.value is None or not where:
            continue
        symbol, unit, factor = symbol_of(key)
        std = None if item.std is None else item.std / factor
        own = pair_of(item.value / factor, std)
        alone = None if item.corrected is None else item.corrected / factor
        shown = with_deviation(alone, std)[0] if alone is not None and std else figure_of(alone)
        rows.append([where, symbol, unit, *own, shown, _repeats(item)])
        if item.note:
            notes.setdefault(item.note, where)
    rows.sort(key=lambda row: str(row[0]))
    header = ["place", "figure", "unit", "value", "±", "robot alone", "repeats"]
    below = bullets([f"{where}: {note}" for note, where in notes.items()]) if notes else ""
    return table(header, rows, numbers=range(3, 7)) + below if rows else ""


def _repeats(item: IsoFigure) -> str:
    return f"{item.n} of {item.wanted}" if item.n < item.wanted else str(item.n)


def _alignment_table(summary: VerifyResult) -> str:
    alignment = summary.alignment
    rows = []
    for words, pose in ((BASE, alignment.T_measured_base), (TOOL, alignment.T_flange_tool)):
        if pose is not None:
            xyz, quat = xyz_quat(pose)
            shown = [figure_of(v / MM, "mm", digits=6) for v in xyz.tolist()]
            rows.append([words, *shown, ", ".join(f"{v:.6f}" for v in quat)])
    parts = [table(["", "x", "y", "z", "quaternion x y z w"], rows, numbers=(1, 2, 3))]
    if alignment.undetermined:
        open_ = [name.removesuffix("_rad").removesuffix("_m") for name in alignment.undetermined]  # without units
        parts.append(bullets([f"not determined by these rows: {', '.join(open_)}"]))
    return "".join(parts)


def course(result: Verification) -> Figure:
    """Return the errors in x, y, z and about x, y, z over time, or row by row."""
    at = result.paired.at_s
    x = result.paired.measured.rows[result.kept].astype(float) if at is None else at[result.kept]
    shown = thinned(np.linalg.norm(result.task[:, :3], axis=1))
    data: list[Plot] = []
    for k in range(result.task.shape[1]):
        turn = k >= 3
        name, colour = f"{'r' if turn else ''}{'xyz'[k % 3]}", (BLUE, ORANGE, GREY)[k % 3]
        y = result.task[shown, k] / (DEG if turn else MM)
        style = {"line": {"color": colour, "width": 1.5}, "marker": {"color": colour, "size": 4}}
        data.append(
            trace("markers" if at is None else "lines", name, x[shown], y, **style, **subplot(2 if turn else 1))
        )
    title = "t, s" if at is not None else "row"
    if result.task.shape[1] == 3:
        return Figure(data=data, layout=layout(xaxis=axis(title), yaxis=axis("mm")), height_px=360)
    return Figure(
        data=data,
        layout=layout(
            xaxis=axis(title, domain=[0.0, 0.46]),
            yaxis=axis("mm"),
            xaxis2=axis(title, domain=[0.54, 1.0], anchor="y2"),
            yaxis2=axis("°", anchor="x2"),
        ),
        height_px=360,
    )


def arrows(result: Verification, arm: Arm) -> Figure:
    """Return the arm at its first posture with an arrow for the error at each place."""
    q = result.paired.q
    if q is None:
        raise ValueError("no joints")
    rows = spread(result.task[:, :3], ARROWS)
    T = result.mounts.tools[0].as_matrix()
    at = (result.paired.F[result.kept[rows]] @ T)[:, :3, 3]
    error = result.task[rows, :3]
    longest = max(float(np.linalg.norm(error, axis=1).max()), 1e-12)
    scale = ARROW_SHARE * max(float(np.ptp(at, axis=0).max()), 1e-3) / longest
    ends = np.stack([at, at + scale * error, np.full_like(at, np.nan)], axis=1).reshape(-1, 3) / MM
    figure = arm_figure(replace(bare_arm(arm), T_flange_tool=result.mounts.tools[0]), q[result.kept[:1]])
    line = trace("lines", f"error, {scale:.0f} times", *ends.T, line={"color": RED, "width": 3})
    return Figure(data=[*figure.data, line], layout=figure.layout, height_px=figure.height_px)


def over_joints(result: Verification, arm: Arm) -> Figure:
    """Return the error of place over each joint's reading."""
    q = result.paired.q
    if q is None:
        raise ValueError("no joints")
    size = np.linalg.norm(result.task[:, :3], axis=1)
    rows = spread(np.column_stack([size, size]))
    data: list[Plot] = []
    more: Plot = {}
    columns = min(arm.n, 3)
    lines = -(-arm.n // columns)
    for i, joint in enumerate(arm.joints):
        k, (line, column) = i + 1, divmod(i, columns)
        name = str(k) if k > 1 else ""
        left, low = column / columns, 1.0 - (line + 1) / lines
        unit = DEG if arm.revolute[i] else MM
        more[f"xaxis{name}"] = axis(
            f"{text(joint.name)}, {'°' if arm.revolute[i] else 'mm'}",
            domain=[left + 0.04, left + 1 / columns - 0.02],
            anchor=f"y{name}",
        )
        up = [low + 0.1, low + 1 / lines - 0.04]
        more[f"yaxis{name}"] = axis("" if column else "mm", domain=up, anchor=f"x{name}")
        x, marker = q[result.kept[rows], i] / unit, {"color": BLUE, "size": 3}
        data.append(trace("markers", text(joint.name), x, size[rows] / MM, marker=marker, **subplot(k)))
    return Figure(data=data, layout=layout(showlegend=False, **more), height_px=260 * lines)


def _compared(page: Page, result: Verification, summary: VerifyResult, other: VerifyResult, error_m: Array) -> str:
    after = [each.after for each in (other, summary) if each.after is not None]
    rows: list[list[object]] = [
        ["place, mm RMS", *(figure_of(each.rms_m / MM) for each in after)],
        ["place, mm largest", *(figure_of(each.max_m / MM) for each in after)],
        ["rotation, ° RMS", *(_degrees(each.rms_rad) for each in after)],
        ["rows", other.n, summary.n],
        ["cause", other.cause, summary.cause],
    ]
    own = np.linalg.norm(result.task[:, :3], axis=1)
    edges = np.linspace(0.0, float(max(own.max(), error_m.max())) / MM, HISTOGRAM_BARS + 1)
    middle, width = 0.5 * (edges[1:] + edges[:-1]), float(edges[1] - edges[0])
    data = [
        bars(
            middle,
            np.histogram(error / MM, edges)[0] / len(error),
            width,
            colour,
            name=name,
            opacity=0.6,
            hoverinfo="skip",
        )
        for name, error, colour in (("other", error_m, GREY), ("this", own, BLUE))
    ]
    shape = layout(xaxis=axis("error of place, mm"), yaxis=axis("share of the rows", tickformat=".0%"))
    figure = Figure(data=data, layout=shape, height_px=300)
    return table(["", "the other run", "this run"], rows, numbers=(1, 2)) + page.plot(figure)
