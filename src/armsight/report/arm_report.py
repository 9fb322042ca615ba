"""The page of an arm's calibration: verdict, errors before and after, corrections, what the tool's place is worth."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from armsight._files import arm_source
from armsight.calibrate.arm import ArmPoints, ArmResult
from armsight.report.figures import BLUE, GREY, Figure, axis, cloud_figure, layout, trace
from armsight.report.html import NOTHING, Card, Given, Page, page_unit, table
from armsight.units import MM, displayed_name, figure_of, with_deviation

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
        Card(name="error before", value=figure_of(result.left_before.mean_m / MM, "mm"), note=f"mean, {kind}"),
        Card(
            name="error after",
            value=figure_of(result.left_after.mean_m / MM, "mm"),
            note=f"mean, {kind}; they scatter by {spread}",
        ),
        Card(name="largest error after", value=figure_of(result.left_after.max_m / MM, "mm"), note=kind),
        Card(name="noise of a place", value=figure_of(result.position_noise_m / MM, "mm"), note="one coordinate"),
        Card(name="parameters corrected", value=str(len(result.free)), note=f"condition {result.condition:.3g}"),
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
