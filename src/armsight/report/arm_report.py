"""Pages of arms: of a calibration, errors before and after; of an identification, paths, residuals and the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from armsight._files import arm_source
from armsight.arrays import Array
from armsight.calibrate.arm import ArmPoints, ArmResult
from armsight.calibrate.identify import Identification, Sweeps
from armsight.calibrate.identify.sweeps import placed
from armsight.columns import DH_ROW
from armsight.kinematics import Arm
from armsight.optics import Rig
from armsight.report.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    Figure,
    Plot,
    axis,
    cloud_figure,
    layout,
    points_in_space,
    trace,
)
from armsight.report.html import NOTHING, Card, Given, Page, page_unit, table
from armsight.units import DEG, MM, displayed_name, figure_of, with_deviation

CLOUD = 600
"""Joint positions at which the tool's uncertainty is drawn."""


def arm_report(result: ArmResult, files: Sequence[Path] = (), given: Given = NOTHING) -> str:
    """Return the page as HTML text that needs no other file."""
    page = Page(
        title=f"Calibration of {result.nominal.name}",
        subtitle=f"{result.n} measurements, {result.level}",
        verdict=result.verdict_,
        cards=_cards(result),
    )
    page.add_notes(result.notes)
    page.add(
        "Errors row by row",
        "At the tool's point, with the nominal geometry (base and tool fitted) and with the corrected one.",
        page.plot(error_figure(result)),
    )
    if result.free:
        page.add("Corrections", "Changes to the nominal arm, with standard deviations.", _corrections(result))
    if result.features is not None:
        rows = [[one.name, one.kind, one.n, figure_of(one.rms_m / MM)] for one in result.features]
        page.add("Touched", "", table(["feature", "kind", "touches", "RMS, mm"], rows, numbers=(2, 3)))
    page.add(
        "Where the tool's place is how certain",
        "Standard deviation that the arm's parameters leave at the tool, at random positions between those measured.",
        page.plot(workspace_figure(result)),
    )
    if result.fixed:
        page.add("Not corrected", "", table(["parameter", "why"], [list(item) for item in result.fixed]))
    if result.outliers:
        rows = [[row, figure_of(error / MM, "mm")] for row, error in result.outliers]
        page.add("Rows that miss by far", "They pulled little.", table(["row", "error"], rows, numbers=(1,)))
    texts = {name: str(value) for name, value in given.items() if isinstance(value, str | PathLike)}
    inputs = [("measurements", Path(texts[name]).name) for name in ("q", "touch", "holdout") if name in texts]
    if "nominal" in texts:
        inputs = [("model", arm_source(texts["nominal"], tip=texts.get("tip"), base=texts.get("base"))), *inputs]
    page.add_inputs(inputs)
    return page.html()


def _cards(result: ArmResult) -> list[Card]:
    kind = "rows of the holdout" if result.held else "rows left out by cross-validation"
    after = result.left_after
    spread = figure_of(float(np.sqrt(max(after.rms_m**2 - after.mean_m**2, 0.0))) / MM, "mm", digits=2)
    return [
        Card("error before", figure_of(result.left_before.mean_m / MM, "mm"), f"mean, {kind}"),
        Card("error after", figure_of(result.left_after.mean_m / MM, "mm"), f"mean, {kind}; they scatter by {spread}"),
        Card("largest error after", figure_of(result.left_after.max_m / MM, "mm"), kind),
        Card("noise of a place", figure_of(result.position_noise_m / MM, "mm"), "one coordinate"),
        Card("parameters corrected", str(len(result.free)), f"condition {result.condition:.3g}"),
    ]


def _corrections(result: ArmResult) -> str:
    std = result.std()
    rows = []
    for name in result.free:
        stem, unit, factor = displayed_name(name)
        unit, factor = ("mrad per m", 1e-3) if name.endswith(".sag") else (unit, factor)
        shown, uncertainty = with_deviation(result.change(name) / factor, std[name] / factor)
        rows.append([stem, shown, uncertainty, page_unit(unit)])
    return table(["parameter", "change", "±", "unit"], rows, numbers=(1, 2))


def error_figure(result: ArmResult) -> Figure:
    """Return the errors of all rows before and after."""
    rows = np.arange(1, len(result.error_m) + 1)
    traces = [
        trace("markers", name, rows, errors / MM, marker={"color": colour})
        for name, errors, colour in (("nominal", result.before_m, GREY), ("corrected", result.error_m, BLUE))
    ]
    log = {"type": "log", "dtick": "D2", "tickformat": "~g"} if result.before_m.min() > 0.0 else {}
    high = axis("error, mm", **log)
    return Figure(data=traces, layout=layout(xaxis=axis("row"), yaxis=high))


def workspace_figure(result: ArmResult) -> Figure:
    """Return the tool's place at random joint positions, coloured by its standard deviation."""
    points = result.points
    q = np.random.default_rng(0).uniform(points.q.min(axis=0), points.q.max(axis=0), (CLOUD, points.q.shape[1]))
    there = ArmPoints(q=q, xyz_m=np.zeros((CLOUD, 3)), point=(points.point[0],) * CLOUD)
    T, J = result.model.predict(result.fitted.p, there)
    sigma = np.zeros(CLOUD)
    if result.covariance is not None:
        index = [result.model.names.index(name) for name in result.covariance.names]
        A = J[:, :3, index]
        sigma = np.sqrt(np.einsum("mij,jk,mik->m", A, result.covariance.matrix, A))
    return cloud_figure(T[:, :3, 3], sigma, points.xyz_m)


ENTRIES = tuple((name, displayed_name(name)[2]) for name in DH_ROW)
TITLES = ("a, mm", "alpha, °", "d, mm", "theta, °", "beta, °")
COLOURS = (BLUE, ORANGE, GREEN, "#7b4fa3", "#2a8fa0", "#8a6d3b")


def identify_report(result: Identification, files: Sequence[Path] = (), given: Given = NOTHING) -> str:
    """Return the page as HTML text that needs no other file. files: that went in. given: `out` of planned sweeps."""
    xyz, nominal = _positions(result.sweeps, result.rig), result.nominal
    page = _head(result)
    page.add_notes(result.notes)
    page.add(
        "Table",
        "Denavit-Hartenberg parameters, ± one standard deviation. All readings of a joint together tell them, so that "
        "they may be known far more closely than one reading is.",
        _table(result),
    )
    if nominal is not None:
        page.add("Beside the nominal arm", f"Identified, and {nominal.name}.", _beside(result, nominal))
    page.add(
        "Paths and axes",
        "Readings by joint, where the result puts the beacon (small), and the axes with all joints at zero. Diamonds "
        "are readings that were discarded.",
        page.plot(path_figure(result, xyz)),
    )
    page.add("Residuals", "Distance of each reading from the result.", page.plot(residual_figure(result, xyz)))
    if result.uncertainty is not None:
        page.add(
            "Where the beacon's place is how certain",
            "Standard deviation that the identified arm leaves at the beacon, at random positions between those swept.",
            page.plot(beacon_figure(result, xyz)),
        )
    made = [] if result.plan is None else [Path(str(given["out"])).with_suffix(".sweep.csv")]
    page.add_inputs([("file", item.name) for item in (*made, *files)])
    return page.html()


def _head(result: Identification) -> Page:
    """Return the page with its title, verdict and figures, as yet without sections."""
    kinds = "".join("R" if joint.axis.revolute else "P" for joint in result.joints)
    return Page(
        title=f"Identified arm: {kinds}",
        subtitle=f"{len(result.sweeps)} readings, method {result.method}",
        verdict=result.verdict_,
        cards=_joint_cards(result),
    )


def _joint_cards(result: Identification) -> list[Card]:
    noise = f"{result.sigma:.3g} px" if result.rig is not None else figure_of(result.sigma / MM, "mm")
    cards = [Card("noise", noise, "one coordinate, found from the residuals")]
    for number, joint in enumerate(result.joints, 1):
        travel = joint.travel[1] - joint.travel[0]
        turns = joint.axis.revolute
        value = f"{travel / DEG:.0f}°" if turns else figure_of(travel / MM, "mm")
        cards.append(Card(f"joint {number}, {'turns' if turns else 'slides'}", value, "travel swept"))
    return cards


def _table(result: Identification) -> str:
    rows = []
    for number, (joint, found) in enumerate(zip(result.arm.joints, result.joints, strict=True), 1):
        cells: list[object] = [number, str(joint.type)]
        for key, unit in ENTRIES:
            uncertainty = found.std[key]
            known = math.isfinite(uncertainty)
            if uncertainty == 0.0:  # beta of axes that are not nearly parallel
                cells.append("0")
                continue
            shown, plus = with_deviation(getattr(joint, key) / unit, uncertainty / unit if known else None)
            cells.append(f"{shown} ± {plus}" if known else f"{shown} (chosen)")
        rows.append(cells)
    return table(["joint", "type", *TITLES], rows, numbers=(2, 3, 4, 5, 6))


def _beside(result: Identification, nominal: Arm) -> str:
    """Return entries beside those of the nominal arm; those that are chosen are left out."""
    rows = []
    for number, (joint, found, other) in enumerate(
        zip(result.arm.joints, result.joints, nominal.joints, strict=True), 1
    ):
        cells: list[object] = [number, str(joint.type), str(other.type)]
        for key, unit in ENTRIES:
            known = math.isfinite(found.std[key])
            was = getattr(other, key) / unit
            cells.append(f"{getattr(joint, key) / unit:.5g} | {was:.5g}" if known else f"| {was:.5g}")
        rows.append(cells)
    head = ["joint", "type", "nominal type", *(f"{name} | nominal" for name in TITLES)]
    return table(head, rows, numbers=(3, 4, 5, 6, 7))


def beacon_figure(result: Identification, xyz_m: Array) -> Figure:
    """Return the beacon's place at random joint positions within the travel, coloured by its standard deviation."""
    if result.uncertainty is None:
        return cloud_figure(np.empty((0, 3)), np.empty(0), xyz_m)
    travel = np.array([joint.travel for joint in result.joints])
    q = np.random.default_rng(0).uniform(travel[:, 0], travel[:, 1], (CLOUD, len(travel)))
    positions, C = result.uncertainty.positions(q)
    return cloud_figure(positions, np.sqrt(np.einsum("mii->m", C)), xyz_m)


def _positions(sweeps: Sweeps, rig: Rig | None) -> Array:
    if rig is None or sweeps.uv_px is None:
        return sweeps.xyz_m
    return placed(sweeps, rig, 1.0).xyz_m


def path_figure(result: Identification, xyz_m: Array) -> Figure:
    """Return readings, predictions and axes in rig axes."""
    traces: list[Plot] = []
    size = float(np.linalg.norm(np.ptp(xyz_m, axis=0)))
    for j, joint in enumerate(result.joints):
        colour = COLOURS[j % len(COLOURS)]
        seen, where = xyz_m[joint.rows] / MM, result.predicted_m[result.sweeps.rows(j)] / MM
        ends = (joint.axis.point_m + np.outer([-0.3 * size, 0.3 * size], joint.axis.direction)) / MM
        lost = xyz_m[[row for row, _ in joint.discarded]] / MM
        traces += [
            _cloud(f"joint {j + 1}", seen, "markers", {"size": 4, "color": colour}),
            _cloud(f"joint {j + 1}, result", where, "lines+markers", {"size": 2, "color": colour}),
            _cloud(f"axis {j + 1}", ends, "lines", {"size": 1, "color": GREY}),
        ]
        if len(lost):
            traces.append(
                _cloud(f"joint {j + 1}, discarded", lost, "markers", {"size": 5, "color": RED, "symbol": "diamond"})
            )
    scene = {"aspectmode": "data", **{f"{a}axis": {"title": {"text": f"{a}, mm"}} for a in "xyz"}}
    return Figure(data=traces, layout=layout(scene=scene), height_px=560)


def _cloud(name: str, xyz: Array, mode: str, marker: Plot) -> Plot:
    return points_in_space(name, xyz, marker, mode) | {"line": {"color": marker["color"], "width": 3}}


def residual_figure(result: Identification, xyz_m: Array) -> Figure:
    """Return the distances of the readings from the result, by joint."""
    traces = []
    off = np.linalg.norm(result.predicted_m - xyz_m, axis=1) / MM
    for j in range(result.sweeps.n):
        rows = result.sweeps.rows(j)
        marker = {"color": COLOURS[j % len(COLOURS)]}
        dots = {"type": "scatter", "mode": "markers", "x": rows + 1, "y": off[rows], "marker": marker}
        traces.append({"name": f"joint {j + 1}", **dots})
    return Figure(data=traces, layout=layout(xaxis=axis("reading"), yaxis=axis("distance, mm")))
