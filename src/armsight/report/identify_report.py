"""The page of an identification: the paths with circles and lines, residuals, the table, what is not known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.identify import Identification, Sweeps
from armsight.optics import Rig, triangulate
from armsight.report.figures import BLUE, GREEN, GREY, ORANGE, RED, Figure, axis, layout
from armsight.report.html import Card, Page, Verdict, bullets, figure_of, table, with_deviation
from armsight.units import DEG, MM

Array = NDArray[np.float64]

COLOURS = (BLUE, ORANGE, GREEN, "#7b4fa3", "#2a8fa0", "#8a6d3b")


def identify_report(
    result: Identification,
    sweeps: Sweeps,
    rig: Rig | None = None,
    *,
    inputs: Sequence[tuple[str, str]] = (),
    created: datetime | None = None,
) -> str:
    """Return the page as HTML text that needs no other file. inputs: (what, which) lines for the end of the page."""
    xyz = _places(sweeps, rig)
    sure = all(joint.decided for joint in result.joints)
    kinds = "".join("R" if joint.axis.revolute else "P" for joint in result.joints)
    page = Page(
        title=f"Identified arm: {kinds}",
        subtitle=f"{len(sweeps)} readings, method {result.method}",
        verdict=Verdict(
            level="good" if sure else "warn",
            word="Types decided" if sure else "A type is not decided",
            sentence=_sentence(result),
        ),
        cards=_cards(result, rig),
    )
    if result.notes:
        page.add("What to know", "", bullets(result.notes))
    page.add("Table", "Denavit-Hartenberg parameters with standard deviations.", _table(result))
    page.add(
        "Paths and axes",
        "Readings by joint, where the result puts the beacon (small), and the axes with all joints at zero. Crosses "
        "are readings that were discarded.",
        page.plot(path_figure(result, sweeps, xyz)),
    )
    page.add("Residuals", "Distance of each reading from the result.", page.plot(residual_figure(result, sweeps, xyz)))
    if inputs:
        page.add("What went in", "", table(["", ""], [list(item) for item in inputs]))
    return page.html(created=created or datetime.now())


def _sentence(result: Identification) -> str:
    worst = max(joint.residual_rms_m for joint in result.joints)
    lost = sum(len(joint.discarded) for joint in result.joints)
    text = f"The readings agree with the arm to {worst / MM:.3g} mm RMS on the worst joint"
    return text + (f"; {lost} readings were discarded." if lost else ".")


def _cards(result: Identification, rig: Rig | None) -> list[Card]:
    noise = f"{result.sigma:.3g} px" if rig is not None else figure_of(result.sigma / MM, "mm")
    cards = [Card(name="noise", value=noise, note="one coordinate, found from the residuals")]
    for number, joint in enumerate(result.joints, 1):
        travel = joint.travel[1] - joint.travel[0]
        turns = joint.axis.revolute
        value = f"{travel / DEG:.0f}°" if turns else figure_of(travel / MM, "mm")
        cards.append(Card(name=f"joint {number}, {'turns' if turns else 'slides'}", value=value, note="travel swept"))
    return cards


def _table(result: Identification) -> str:
    rows = []
    for number, (joint, found) in enumerate(zip(result.arm.joints, result.joints, strict=True), 1):
        cells: list[object] = [number, str(joint.type)]
        for key, unit in (("a_m", MM), ("alpha_rad", DEG), ("d_m", MM), ("theta_rad", DEG), ("beta_rad", DEG)):
            doubt = found.std[key]
            known = math.isfinite(doubt)
            shown, plus = with_deviation(getattr(joint, key) / unit, doubt / unit if known else None)
            cells.append(f"{shown} ± {plus}" if known else f"{shown} (chosen)")
        rows.append(cells)
    return table(["joint", "type", "a, mm", "alpha, °", "d, mm", "theta, °", "beta, °"], rows, numbers=(2, 3, 4, 5, 6))


def _places(sweeps: Sweeps, rig: Rig | None) -> Array:
    if rig is None or sweeps.uv_px is None:
        return sweeps.xyz_m
    noise = np.tile(np.eye(2), (len(sweeps), 1, 1))
    return triangulate(rig, sweeps.uv_px[:, 0], sweeps.uv_px[:, 1], noise, noise).xyz_m


def path_figure(result: Identification, sweeps: Sweeps, xyz_m: Array) -> Figure:
    """Return readings, predictions and axes in rig axes."""
    traces: list[dict[str, Any]] = []
    size = float(np.linalg.norm(np.ptp(xyz_m, axis=0)))
    for j, joint in enumerate(result.joints):
        colour = COLOURS[j % len(COLOURS)]
        seen, where = xyz_m[joint.rows] / MM, result.predicted_m[sweeps.rows(j)] / MM
        ends = (joint.axis.point_m + np.outer([-0.3 * size, 0.3 * size], joint.axis.direction)) / MM
        lost = xyz_m[[row for row, _ in joint.discarded]] / MM
        traces += [
            _cloud(f"joint {j + 1}", seen, "markers", {"size": 4, "color": colour}),
            _cloud(f"joint {j + 1}, result", where, "lines+markers", {"size": 2, "color": colour}),
            _cloud(f"axis {j + 1}", ends, "lines", {"size": 1, "color": GREY}),
        ]
        if len(lost):
            traces.append(
                _cloud(f"joint {j + 1}, discarded", lost, "markers", {"size": 5, "color": RED, "symbol": "x"})
            )
    scene = {"aspectmode": "data", **{f"{a}axis": {"title": {"text": f"{a}, mm"}} for a in "xyz"}}
    return Figure(data=traces, layout=layout(scene=scene), height_px=560)


def _cloud(name: str, xyz: Array, mode: str, marker: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "scatter3d", "mode": mode, "name": name, "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2],
        "marker": marker, "line": {"color": marker["color"], "width": 3},
    }  # fmt: skip


def residual_figure(result: Identification, sweeps: Sweeps, xyz_m: Array) -> Figure:
    """Return the distances of the readings from the result, by joint."""
    traces = []
    off = np.linalg.norm(result.predicted_m - xyz_m, axis=1) / MM
    for j in range(sweeps.n):
        rows = sweeps.rows(j)
        traces.append(
            {"type": "scatter", "mode": "markers", "name": f"joint {j + 1}", "x": rows + 1, "y": off[rows],
             "marker": {"color": COLOURS[j % len(COLOURS)]}}
        )  # fmt: skip
    return Figure(data=traces, layout=layout(xaxis=axis("reading"), yaxis=axis("distance, mm")))
