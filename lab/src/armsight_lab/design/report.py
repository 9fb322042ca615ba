"""The page of a planned rig: a map of the deviations over its volume, what they are made of, what to change."""

from __future__ import annotations

import numpy as np

from armsight.arrays import Array
from armsight.report.figures import GREY, INK, Figure, Plot, axis, layout
from armsight.report.html import Card, Page, bullets, table
from armsight.units import DEG, MM, figure_of
from armsight_lab.design.records import DesignChange, DesignOutput
from armsight_lab.design.volume import Forecast

COLOURS = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725")
"""Viridis in eight steps, the least deviation dark: told apart by the colour-blind, and in grey."""
MOST_SLICES = 6
EDGES_PX, WIDE_PX, TALLEST_PX = 60.0, 400.0, 460.0
"""Of a slice: margins, width within them in a page of two columns, and the greatest height."""


def _cameras(done: DesignOutput, found: Forecast) -> str:
    if done.baseline_m is not None:
        return f"baseline {figure_of(done.baseline_m / MM)} mm"
    return f"cameras {', '.join(found.rig.names)}"


def design_report(done: DesignOutput, found: Forecast) -> str:
    """Return the page as HTML text that needs no other file; found: the cells that done sums up."""
    page = Page(
        title="What a rig will measure",
        subtitle=f"{_cameras(done, found)}, focal length {figure_of(done.focal_px)} px; "
        f"the volume is in the axes of the {done.frame}",
        verdict=done.verdict_,
        cards=_cards(done),
    )
    if done.advice:
        page.add("What to do, and what to know", "", bullets([_sentence(text) for text in done.advice]))
    _add_map(page, found, found.position_m / MM, "position", "mm")
    if done.changes:
        page.add(
            "What changes lead to",
            "Each was worked out anew, with its own calibration. What suffices comes first, the cheapest first.",
            _changes(done),
        )
    page.add("What the deviation is made of", "RMS over the measured cells; the parts add up as squares.", _parts(done))
    if done.points:
        rows = [
            [one.name, *(figure_of(value / MM) for value in (one.median_m, one.p95_m, one.worst_m))]
            for one in done.points
        ]
        header = ["", "median, mm", "95 %, mm", "worst, mm"]
        page.add(
            "Each light by itself", "As points.csv of a measurement has them.", table(header, rows, numbers=(1, 2, 3))
        )
    if done.not_measured:
        rows = [
            [one.why, f"{100.0 * one.share:.1f} %", "position alone" if one.position else "nothing"]
            for one in done.not_measured
        ]
        page.add("Where there is no pose", "", table(["why", "of the volume", "what is measured"], rows, numbers=(1,)))
    if done.orientation is not None:
        _add_map(page, found, found.orientation_rad / DEG, "orientation", "°")
    if done.simulation is not None:
        page.add("Simulated", _simulated(done), _places(done))
    page.add("Taken for granted", "", bullets([_sentence(text) for text in done.assumptions]))
    return page.html()


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _cards(done: DesignOutput) -> list[Card]:
    at = ", ".join(f"{value:.3g}" for value in done.position.worst_at_m)
    cards = [
        Card("position, median", f"{figure_of(done.position.median / MM)} mm"),
        Card("position, 95 %", f"{figure_of(done.position.p95 / MM)} mm"),
        Card("position, worst", f"{figure_of(done.position.worst / MM)} mm", f"at ({at}) m"),
        Card("measured", f"{100.0 * done.measured:.0f} %", "of the volume"),
    ]
    if done.orientation is not None:
        cards.append(Card("orientation, 95 %", f"{figure_of(done.orientation.p95 / DEG)}°"))
    if done.aligned is not None and done.deviation_in == "rig":
        note = "once the volume is aligned"
        cards.append(Card("position, 95 %, aligned", f"{figure_of(done.aligned.p95 / MM)} mm", note))
    return cards


def _changes(done: DesignOutput) -> str:
    now = done.orientation.p95 / DEG if done.orientation else None
    rows = [
        [
            "as planned",
            figure_of(done.position.p95 / MM),
            figure_of(now),
            f"{100.0 * done.measured:.0f}",
            _mark(done.reached),
        ]
    ]
    rows += [_change(one) for one in done.changes]
    header = ["", "position, 95 %, mm", "orientation, 95 %, °", "measured, %", "suffices"]
    return table(header, rows, numbers=(1, 2, 3))


def _change(one: DesignChange) -> list[str]:
    name = one.change if one.why is None else f"{one.change}: {one.why}"
    position = None if one.position_m is None else one.position_m / MM
    turn = None if one.orientation_rad is None else one.orientation_rad / DEG
    return [name, figure_of(position), figure_of(turn), f"{100.0 * one.measured:.0f}", _mark(one.sufficient)]


def _mark(sufficient: bool | None) -> str:
    return "" if sufficient is None else "yes" if sufficient else "no"


def _parts(done: DesignOutput) -> str:
    rows = [
        [
            part.name,
            figure_of(part.position_m / MM),
            figure_of(None if part.orientation_rad is None else part.orientation_rad / DEG),
            f"{100.0 * part.share:.0f}",
        ]
        for part in done.parts
    ]
    header = ["", "position, mm", "orientation, °", "of the position's variance, %"]
    return table(header, rows, numbers=(1, 2, 3))


def _simulated(done: DesignOutput) -> str:
    one = done.simulation
    if one is None:
        return ""
    turn = "" if one.ratio_orientation is None else f", of the orientation {one.ratio_orientation:.2f}"
    return (
        f"{one.n_runs} calibrations and {one.n_poses} measured poses of a simulated world that shares no code with the "
        f"forecast: the deviation of the position is {one.ratio_position:.2f} times the one foretold{turn} (± "
        f"{one.ratio_std:.2f} by their number). {one.n_failed} calibrations were refused, {one.n_lost} poses were lost."
    )


def _places(done: DesignOutput) -> str:
    places = done.simulation.places if done.simulation is not None else ()
    rows = [
        [
            ", ".join(f"{value:.3g}" for value in one.xyz_m),
            figure_of(one.expected_m / MM),
            figure_of(one.position_m / MM),
            figure_of(None if one.expected_rad is None else one.expected_rad / DEG),
            figure_of(None if one.orientation_rad is None else one.orientation_rad / DEG),
        ]
        for one in places
    ]
    header = ["at, m", "position foretold, mm", "simulated, mm", "orientation foretold, °", "simulated, °"]
    return table(header, rows, numbers=(1, 2, 3, 4))


def _add_map(page: Page, found: Forecast, values: Array, what: str, unit: str) -> None:
    """Add the slices of the volume across z, coloured by the deviation, from front to back."""
    nx, ny, nz = found.cells.counts
    chosen = np.unique(np.linspace(0, nz - 1, min(nz, MOST_SLICES)).round().astype(int))
    steps = _steps(values)
    plots = []
    for k in chosen.tolist():
        part = slice(k * nx * ny, (k + 1) * nx * ny)
        figure = _slice(found, part, values[part], steps, unit)
        plots.append(f"<div><p>z = {found.cells.xyz_m[part.start, 2]:.3g} m</p>{page.plot(figure)}</div>")
    page.add(
        f"Deviation of the {what} over the volume, {unit}",
        f"Slices of the volume from front to back, in the axes of the {found.plan.frame}: x to the right, y down. Each "
        "cell has the colour of the expected deviation (RMS) at its middle; grey: not measured. Point at a cell for "
        "its figure.",
        _legend(steps, unit),
        f'<div class="pair">{"".join(plots)}</div>',
    )


def _steps(values: Array) -> Array:
    """Return the borders (9,) of the colours, even in the logarithm."""
    known = values[np.isfinite(values)]
    low, high = float(known.min()), float(known.max())
    high = max(high, 1.02 * low)
    return np.asarray(np.geomspace(low, high, len(COLOURS) + 1))


def _legend(steps: Array, unit: str) -> str:
    gap = "" if unit == "°" else " "
    items = [
        f'<span style="display:inline-block;white-space:nowrap;margin-right:14px">'
        f'<i style="display:inline-block;width:14px;height:14px;border-radius:3px;vertical-align:-2px;margin-right:5px;'
        f'background:{colour}"></i>{figure_of(low)}–{figure_of(high)}{gap}{unit}</span>'
        for colour, low, high in zip(COLOURS, steps[:-1], steps[1:], strict=True)
    ]
    items.append(
        '<span style="display:inline-block;white-space:nowrap"><i style="display:inline-block;width:14px;height:14px;'
        f'border-radius:3px;vertical-align:-2px;margin-right:5px;background:{GREY}"></i>not measured</span>'
    )
    return f'<p style="font-size:13px;line-height:1.9">{"".join(items)}</p>'


def _slice(found: Forecast, part: slice, values: Array, steps: Array, unit: str) -> Figure:
    """Return one slice: cells as filled shapes, a trace for each colour."""
    xyz = found.cells.xyz_m[part]
    half = 0.5 * np.array([_pitch(xyz[:, 0]), _pitch(xyz[:, 1])])
    why = found.why[part]
    colour = np.clip(np.searchsorted(steps, values, side="right") - 1, 0, len(COLOURS) - 1)
    colour = np.where(np.isfinite(values), colour, -1)
    data: list[Plot] = []
    for k in np.unique(colour).tolist():
        index = np.flatnonzero(colour == k)
        data.append(_cells(xyz[index], half, GREY if k < 0 else COLOURS[k]))
    gap = "" if unit == "°" else " "
    told = [
        f"({x:.3g}, {y:.3g}, {z:.3g}) m: " + (f"{figure_of(value)}{gap}{unit}" if np.isfinite(value) else text)
        for (x, y, z), value, text in zip(xyz.tolist(), values.tolist(), why, strict=True)
    ]
    data.append(
        {
            "type": "scatter",
            "mode": "markers",
            "x": xyz[:, 0],
            "y": xyz[:, 1],
            "marker": {"size": 14, "color": INK, "opacity": 0.0},
            "text": told,
            "hovertemplate": "%{text}<extra></extra>",
            "showlegend": False,
        }
    )
    ends = [[float(xyz[:, a].min() - half[a]), float(xyz[:, a].max() + half[a])] for a in range(2)]
    shape = layout(
        xaxis=axis("x, m", range=ends[0], showgrid=False, zeroline=False),
        yaxis=axis("y, m", range=ends[1][::-1], showgrid=False, zeroline=False, scaleanchor="x", constrain="domain"),
        showlegend=False,
        margin={"l": 58, "r": 12, "t": 10, "b": 44},
    )
    wide, high = (ends[a][1] - ends[a][0] for a in range(2))
    return Figure(data=data, layout=shape, height_px=round(min(EDGES_PX + WIDE_PX * high / wide, TALLEST_PX)))


def _pitch(places: Array) -> float:
    """Return the distance of neighbouring cells; of a single row a share of a metre that can be seen."""
    different = np.unique(places.round(9))
    return float(np.diff(different).min()) if len(different) > 1 else 0.1


def _cells(xyz: Array, half: Array, colour: str) -> Plot:
    """Return cells as filled shapes of one colour."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    at = xyz[:, None, :2] + corners * half  # (m, 5, 2)
    path = np.concatenate([at, np.full((len(at), 1, 2), np.nan)], axis=1).reshape(-1, 2)
    return {
        "type": "scatter",
        "mode": "lines",
        "x": path[:, 0],
        "y": path[:, 1],
        "fill": "toself",
        "fillcolor": colour,
        "line": {"width": 1, "color": colour},
        "hoverinfo": "skip",
        "showlegend": False,
    }
