"""The page of a cell's calibration: what it is worth at the tip, what was learned from what, what nobody can tell."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from os import PathLike
from pathlib import Path

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cell import CellResult
from armsight.calibrate.cell.model import CLOCK_AT, PER_CAMERA, POSE_AT
from armsight.calibrate.cell.result import UNLEARNED_BITS, Learned
from armsight.optics import SIDES
from armsight.report.figures import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    RED,
    Figure,
    Plot,
    axis,
    layout,
    points_in_space,
    subplot,
    trace,
)
from armsight.report.html import NOTHING, Card, Given, Page, bullets, page_unit, table, text
from armsight.report.scene import camera_line, line, scene_axes
from armsight.units import DEG, MM, displayed_name, figure_of, with_deviation

STRONGEST = 16
"""Parameters whose correlations are drawn: those that take part in the strongest ones."""
UNITS = {
    **dict.fromkeys(("_m", ".tx", ".ty", ".tz"), ("mm", MM)),
    **dict.fromkeys(("_rad", ".rx", ".ry", ".rz"), ("°", DEG)),
    **dict.fromkeys((".fx", ".fy", ".cx", ".cy"), ("px", 1.0)),
    "_ppm": ("ppm", 1.0),
    "_s": ("ms", 1e-3),
    ".sag": ("mrad per m", 1e-3),
}
"""Endings of parameters' names, with the unit that people read and what one of it is."""
BASE_M = 0.15
"""Length of the base's drawn axes."""
PYRAMID_M = 0.12


def cell_report(done: CellResult, files: Sequence[Path] = (), given: Given = NOTHING) -> str:
    """Return the page as HTML text that needs no other file."""
    page = Page(
        title=f"Calibration of a cell with {done.nominal.name}",
        subtitle=f"{done.duration_s:.0f} s of motion, {done.n_frames} frames, {done.n_spots} spots",
        verdict=done.verdict_,
        cards=_cards(done),
    )
    if done.notes or done.advice:
        page.add("What to know, and to do", "", bullets([*done.notes, *done.advice]))
    page.add(
        "How well the tip is known, where",
        f"In base axes, at places of the recording that {done.all_cameras} saw; colours are standard deviations of "
        "the tip's place in mm. Outside of them nothing was checked. Click in the legend for what the calibrated arm's "
        "joints alone tell.",
        page.plot(tip_figure(done)),
    )
    page.add(
        "Residuals over time",
        "Root mean square of a spot's coordinate in each second of motion. A step or a ramp would be something that "
        "moved; the level is the spots' noise. Stretches that the fit did not see "
        f"({' and '.join(map(figure_of, done.left_out_px.values()))} px) are met as well as those "
        f"that it saw ({' and '.join(map(figure_of, done.residual_px.values()))} px) where the "
        "model is right.",
        page.plot(residual_figure(done)),
    )
    page.add(
        "The arm before and after",
        "As its file says, what was found, and by how much: a change below two standard deviations is none.",
        _arm_table(done),
    )
    page.add(
        "What decided what",
        "Which share of what the recording tells about each part stems from each second. A part that hangs on a few "
        "seconds hangs on few data.",
        page.plot(information_figure(done)),
    )
    _add_parameters(page, done, _inputs(given))
    return page.html()


def _inputs(given: Given) -> list[tuple[str, str]]:
    sides = [(f"{side} camera", name) for side in SIDES for name in (side, f"{side}_spots")]
    named = (("arm", "model"), ("target", "target"), ("robot's log", "robot_log"), *sides)
    told = [(what, given.get(name)) for what, name in named]
    return [(what, str(one)) for what, one in told if isinstance(one, str | PathLike)]


def _add_parameters(page: Page, done: CellResult, inputs: Sequence[tuple[str, str]]) -> None:
    """Add what speaks for the result, what nobody can tell, all parameters, and what went in."""
    page.add("Checks", "", _checks(done))
    page.add("What no recording can tell", "How it was fixed.", bullets(done.gauges))
    page.add(
        "All that was learned",
        f"bits: how often the standard deviation was halved; below {UNLEARNED_BITS:g} the recording says nothing new.",
        _learned_table(done),
    )
    page.add(
        "What hangs together",
        f"Correlations of the {STRONGEST} parameters that hang on each other most: beside ±1 only a sum or a "
        "difference of the two is known.",
        page.plot(correlation_figure(done)),
    )
    if done.fixed:
        page.add("Held as in the arm's file", "", f"<p>{text(', '.join(done.fixed))}</p>")
    page.add_inputs(inputs)


def _cards(done: CellResult) -> list[Card]:
    tip = done.tip
    return [
        Card(
            "tip, as the cameras measure it",
            f"± {figure_of(tip.measured_m / MM, 'mm', digits=2)}",
            f"at worst {figure_of(tip.measured_worst_m / MM, 'mm', digits=2)}",
        ),
        Card(
            "tip, as the joints say",
            f"± {figure_of(tip.commanded_m / MM, 'mm', digits=2)}",
            f"at worst {figure_of(tip.commanded_worst_m / MM, 'mm', digits=2)}",
        ),
        Card(
            "noise of one measurement",
            f"± {figure_of(tip.noise_m / MM, 'mm', digits=2)}",
            "comes on top, goes with the mean",
        ),
        *_baseline(done),
        Card(
            "residual, px",
            ", ".join(figure_of(px, digits=2) for px in done.residual_px.values()),
            f"{' and '.join(done.rig.names)} camera, RMS",
        ),
        Card("scale from", f"the {done.scale.set_by}", f"ratio {_ratio(done)}"),
    ]


def _baseline(done: CellResult) -> list[Card]:
    far, std = done.baseline_m, done.baseline_std_m
    if far is None or std is None:
        return []
    value = f"{with_deviation(far / MM, std / MM)[0]} mm"
    return [Card("baseline", value, f"± {figure_of(std / MM, 'mm', digits=2)}")]


def _ratio(done: CellResult) -> str:
    return f"{done.scale.ratio:.4f} ± {done.scale.std:.4f}"


def tip_figure(done: CellResult) -> Figure:
    """Return the tip's places in base axes, coloured by their deviations, with cameras and base."""
    data: list[Plot] = []
    for name, covariance, shown in (
        ("tip, as the cameras measure it", done.tip_measured, True),
        ("tip, as the joints say", done.tip_commanded, "legendonly"),
    ):
        spread = np.sqrt(np.trace(covariance, axis1=1, axis2=2)) / MM
        bar = {"title": {"text": "± mm"}, "thickness": 12, "len": 0.7}
        marker = {"size": 6, "color": spread, "colorscale": "Viridis", "colorbar": bar}
        hover = {"text": [f"± {size:.2g} mm" for size in spread.tolist()], "hovertemplate": "%{text}"}
        data.append({**points_in_space(name, done.tip_places_m / MM, marker), "visible": shown, **hover})
    rig = done.parts.rig
    data += [camera_line(rig, side, done.parts.T_base_rig, depth_m=PYRAMID_M) for side in rig.names]
    for k, (name, colour) in enumerate(zip("xyz", (RED, GREEN, BLUE), strict=True)):
        ends = np.zeros((2, 3))
        ends[1, k] = BASE_M / MM
        data.append(line(ends, f"base {name}", {"width": 5, "color": colour}))
    return Figure(data=data, layout=layout(scene=scene_axes("base")), height_px=560)


def residual_figure(done: CellResult) -> Figure:
    """Return each camera's RMS residual by seconds of the motion."""
    t, of_side = _seconds(done), _by_second(done)
    data: list[Plot] = [
        trace("lines", side, t, rms, line={"color": colour, "width": 1.5})
        for side, rms, colour in zip(done.rig.names, of_side, cycle((BLUE, ORANGE, GREEN, RED, INK)), strict=False)
    ]
    high = axis("residual, px", rangemode="tozero")
    return Figure(data=data, layout=layout(xaxis=axis("robot's time, s"), yaxis=high), height_px=320)


def _seconds(done: CellResult) -> Array:
    """Return the robot's time (b,) of each stretch."""
    found, model = done.solved.fit, done.solved.model
    t = model.times_s(found.x, found.spots)
    return np.asarray(np.bincount(found.block, weights=t) / np.bincount(found.block))


def _by_second(done: CellResult) -> list[Array]:
    """Return the RMS residual of each camera in px in each stretch; NaN where it saw nothing."""
    found = done.solved.fit
    spread = np.sqrt(np.trace(found.spots.covariance_px2, axis1=1, axis2=2) / 2.0)
    own = spread * np.asarray(found.scale)[found.spots.side]
    square = np.mean((found.normals.residuals * own[:, None]) ** 2, axis=1)
    n, out = int(found.block[-1]) + 1, []
    for side in done.solved.model.sides:
        rows = found.spots.side == side
        count = np.bincount(found.block[rows], minlength=n)
        total = np.bincount(found.block[rows], weights=square[rows], minlength=n)
        out.append(np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan)))
    return out


def information_figure(done: CellResult) -> Figure:
    """Return the share of what is known about each part of the cell that stems from each second."""
    t, data = _seconds(done), []
    for k, (name, shares) in enumerate(information_shares(done).items(), start=1):
        line_ = {"color": (BLUE, ORANGE, GREEN, RED, INK)[k - 1], "width": 1.2}
        filled = {"line": line_, "fill": "tozeroy", "showlegend": True}
        data.append(trace("lines", name, t, 100.0 * shares, **filled, **subplot(k)))
    rows = len(data)
    shape = layout(grid={"rows": rows, "columns": 1, "pattern": "independent", "ygap": 0.25})
    for k in range(1, rows + 1):
        key = str(k) if k > 1 else ""
        shape[f"xaxis{key}"] = axis("robot's time, s" if k == rows else "", showticklabels=k == rows)
        shape[f"yaxis{key}"] = axis("%", rangemode="tozero", nticks=3)
    return Figure(data=data, layout=shape, height_px=520)


def information_shares(done: CellResult) -> dict[str, Array]:
    """Return by part of the cell which share (b,) of what the recording tells of it stems from each stretch.

    The trace of the part's covariance times a stretch's information about it: never negative, as both are not.
    """
    model, found = done.solved.model, done.solved.fit
    free = set(found.places.tolist())
    cameras = [side * len(PER_CAMERA) for side in model.sides]
    parts = {
        "lenses": [a + k for a in cameras for k in range(POSE_AT)],
        "cameras' places": [a + k for a in cameras for k in range(POSE_AT, CLOCK_AT)],
        "clocks": [a + k for a in cameras for k in range(CLOCK_AT, len(PER_CAMERA))],
        "arm": list(range(model.arm_at, model.lights_at)),
        "lights": list(range(model.lights_at, len(found.x))),
    }
    out = {}
    for name, rows in parts.items():
        own = [k for k in rows if k in free]
        if own:
            share = np.einsum("gh,bhg->b", done.covariance[np.ix_(own, own)], found.normals.A[:, own][:, :, own])
            out[name] = share / share.sum()
    return out


def _arm_table(done: CellResult) -> str:
    joints = {joint.name: joint for joint in done.nominal.joints}
    rows = []
    for one in done.learned:
        joint, _, key = one.name.rpartition(".")
        if joint not in joints or not hasattr(joints[joint], key):
            continue
        before = float(getattr(joints[joint], key))
        stem, unit, factor = displayed_name(key)
        change, std = with_deviation(one.value / factor, one.std / factor)
        after, _ = with_deviation((before + one.value) / factor, one.std / factor)
        rows.append([f"{joint} {stem}", figure_of(before / factor, digits=6), after, change, std, page_unit(unit)])
    return table(["parameter", "file", "found", "change", "±", "unit"], rows, numbers=(1, 2, 3, 4))


def _checks(done: CellResult) -> str:
    rows = [
        ["target's size, arm's lengths over its file", _ratio(done), "1 within three deviations"],
        [
            "arm strays from its readings by",
            f"{figure_of(done.straying.std_rad / DEG, '°', digits=2)}, for {done.straying.time_s:.0f} s",
            "taken into account in all deviations",
        ],
        ["spots of no light", f"{done.n_left_out}", "lamps, reflections, two lights that touch"],
    ]
    rows += [
        [f"{name} stamps to robot's time", f"{delay:+.5f} s", "in the middle of the recording"]
        for name, delay in done.delay_s.items()
    ]
    rows += [
        [f"{one.told}?", "no", f"{100.0 * one.evidence:.0f} % of the evidence that would be an alarm"]
        for one in done.doubts[:4]
    ]
    return table(["check", "found", "meaning"], rows)


def _learned_table(done: CellResult) -> str:
    return table(
        ["parameter", "value", "±", "known before, ±", "bits"], [*map(_row, done.learned)], numbers=(1, 2, 3, 4)
    )


def _row(one: Learned) -> list[str]:
    unit, factor = next((shown for end, shown in UNITS.items() if one.name.endswith(end)), ("", 1.0))
    shown, std = with_deviation(one.value / factor, one.std / factor)
    before = "–" if one.prior_std is None else figure_of(one.prior_std / factor, digits=2)
    name = one.name
    for ending in ("_m", "_rad", "_s", "_ppm"):
        name = name.removesuffix(ending)
    words = f"{name}, {unit}" if unit else name
    return [words, shown, std, before, "–" if one.bits is None else f"{one.bits:.1f}"]


def correlation_figure(done: CellResult) -> Figure:
    """Return the correlations of the parameters that hang together most, as coloured squares."""
    at = done.solved.fit.places
    C = done.covariance[np.ix_(at, at)]
    size = np.sqrt(np.diag(C))
    R = C / np.outer(size, size) - np.eye(len(at))
    chosen = np.sort(np.argsort(-np.abs(R).max(axis=1))[:STRONGEST])
    R = R[np.ix_(chosen, chosen)] + np.eye(len(chosen))
    names = [text(done.learned[k].name) for k in chosen]
    row, column = (part.ravel() for part in np.indices(R.shape))
    values = R.ravel()
    bar = {"title": {"text": ""}, "thickness": 12, "tickvals": [-1, 0, 1]}
    squares: Plot = {
        "type": "scatter",
        "mode": "markers",
        "showlegend": False,
        "x": column + 1.0,
        "y": row + 1.0,
        "text": [f"{names[i]}, {names[j]}: {r:.2f}" for i, j, r in zip(row, column, values.tolist(), strict=True)],
        "hovertemplate": "%{text}<extra></extra>",
        "marker": {
            "symbol": "square",
            "size": 13,
            "color": values,
            "cmin": -1.0,
            "cmax": 1.0,
            "colorscale": [[0.0, BLUE], [0.5, GREY], [1.0, ORANGE]],
            "colorbar": bar,
        },
    }
    ticks = {
        "tickmode": "array",
        "tickvals": list(range(1, len(names) + 1)),
        "ticktext": names,
        "tickfont": {"size": 9},
    }
    ends = [0.4, len(names) + 0.6]
    shape = layout(xaxis=axis("", **ticks, tickangle=-90, range=ends), yaxis=axis("", **ticks, range=ends[::-1]))
    return Figure(data=[squares], layout=shape, height_px=480)
