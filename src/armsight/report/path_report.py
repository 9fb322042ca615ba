"""The page of a path checked for an arm: verdict, the arm with the path coloured by its trouble, rows, joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from armsight.arrays import Array
from armsight.control.guard import Box, Limits
from armsight.control.guard.limits import joint_bounds
from armsight.control.paths import PathCheck, PathIssue, PathTrouble
from armsight.kinematics import Arm
from armsight.kinematics.numeric import start_values
from armsight.records import TaughtPath
from armsight.records.result_parts import Verdict
from armsight.report.arm_view import arm_figure, line_mm
from armsight.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, Figure, Plot, axis, layout, thinned
from armsight.report.html import Card, Page, table, text
from armsight.units import MM, figure_of

COLOURS: Mapping[PathTrouble, tuple[str, str]] = MappingProxyType(
    {
        PathTrouble.UNREACHED: (RED, "out of reach"),
        PathTrouble.FORBIDDEN: ("#7b1fa2", "forbidden box"),
        PathTrouble.WORKSPACE: ("#b05fc0", "outside the workspace"),
        PathTrouble.JUMP: ("#e0218a", "jump"),
        PathTrouble.BRANCH: ("#a0522d", "other branch"),
        PathTrouble.LIMITS: (ORANGE, "joint range"),
        PathTrouble.SINGULAR: ("#c9a800", "singular"),
        PathTrouble.JOINT_SPEED: (BLUE, "joint too fast"),
        PathTrouble.SPEED: ("#17a2b8", "tool too fast"),
        PathTrouble.TURN: ("#5c6bc0", "tool turns too fast"),
    }
)
"""Colour and word of each trouble; a row with several has the colour of the first of these."""
JOINT_COLOURS = (BLUE, ORANGE, GREEN, RED, "#7b1fa2", "#17a2b8", "#a0522d", "#5c6bc0")
RUN = "Play it slowly first (`armsight play`): the arm's body and the cell are not checked."
MEND = "Do not play it: move or slow the rows in trouble below, or place the path elsewhere, and check again."
MAX_TABLE = 200
NAMES_APART = 0.05
"""Names nearer than this share of the path's size would hide each other."""
FLATTEST = 0.4
"""Of the picture of the path alone, as a share of its widest side."""


def path_report(path: TaughtPath, arm: Arm, limits: Limits, found: PathCheck, *, name: str, refused: str = "") -> str:
    """Return the page of what check_path found, as HTML text that needs no other file; path in world or base.

    refused: why play does not run it, where it does not.
    """
    runs = _runs(found.issues)
    slower = ", slower than asked in those below" if found.issues else ""
    if found.ok and not refused:
        level, headline, said, todo = "good", "can be run", f"{arm.name} can run all {found.rows} rows{slower}.", RUN
    else:
        level, headline, said, todo = "bad", "cannot be run", _sentence(arm, found, runs, refused), MEND
    verdict = Verdict(level=level, headline=headline, reasons=[said], next=[todo])
    page = Page(
        title=f"{name} on {arm.name}",
        subtitle=f"{len(path)} rows in {path.parent}, {path.length_m[-1]:.3f} m",
        verdict=verdict,
        cards=_cards(path, found),
    )
    around, alone = _scenes(path, arm, limits, found, runs)
    page.add(
        "Arm and path",
        "The arm where the path begins, and the boxes. Drag to turn, scroll to zoom.",
        page.plot(around),
    )
    page.add(
        "The path",
        "Green where nothing is wrong; another colour is the way to a row in trouble. Point at it for what is wrong.",
        page.plot(alone),
    )
    if runs:
        header = ["rows", "trouble", "where it is worst"]
        rows = [[_rows_text(run), COLOURS[run[0].trouble][1], _worst(run).text] for run in runs[:MAX_TABLE]]
        page.add("Rows in trouble", "" if len(runs) <= MAX_TABLE else f"The first {MAX_TABLE}.", table(header, rows))
    if len(found.q) > 1:
        explained = "Shares of what limits and arm allow: of its range from the middle, and of its speed."
        page.add("Joints along the path", explained, *(page.plot(one) for one in _joints(path, arm, limits, found)))
    return page.html()


def _sentence(arm: Arm, found: PathCheck, runs: Sequence[Sequence[PathIssue]], refused: str) -> str:
    if refused and found.ok:
        return f"{arm.name} cannot run this path: {refused}."
    first = runs[0][0].text if runs else "not every row is reached"
    return f"{arm.name} cannot run this path: {len(found.issues)} troubles. The first: {first}."


def _cards(path: TaughtPath, found: PathCheck) -> list[Card]:
    return [
        Card("rows reached", f"{len(found.q)} of {found.rows}"),
        Card("troubles", str(len(found.issues))),
        Card("length", figure_of(float(path.length_m[-1]) / MM, "mm", digits=4)),
        Card("time", figure_of(float(found.t_s[-1]), "s"), "at its speeds, without starts and stops"),
    ]


def _runs(issues: Sequence[PathIssue]) -> list[list[PathIssue]]:
    """Return the issues of each kind in runs of rows that follow each other, by their first row."""
    out: list[list[PathIssue]] = []
    for kind in COLOURS:
        for issue in (one for one in issues if one.trouble is kind):
            if out and out[-1][0].trouble is kind and issue.row - out[-1][-1].row <= 1:
                out[-1].append(issue)
            else:
                out.append([issue])
    return sorted(out, key=lambda run: run[0].row)


def _rows_text(run: Sequence[PathIssue]) -> str:
    first, last = run[0].row, run[-1].row
    return f"row {first}" if first == last else f"rows {first} to {last}"


def _worst(run: Sequence[PathIssue]) -> PathIssue:
    def beyond(issue: PathIssue) -> float:
        off = abs(issue.value - issue.limit)
        return float(off) if np.isfinite(off) else -1.0

    return max(run, key=beyond)


def _scenes(
    path: TaughtPath, arm: Arm, limits: Limits, found: PathCheck, runs: Sequence[Sequence[PathIssue]]
) -> tuple[Figure, Figure]:
    """Return the picture of arm, boxes and path, and that of the path alone with its rows named."""
    xyz = path.xyz_m if path.parent == "world" else arm.T_world_base.apply(path.xyz_m)
    start = arm.values(found.q[0]) if len(found.q) else start_values(arm, None)
    picture = arm_figure(arm, np.atleast_2d(start))
    boxes = [*((box, RED) for box in limits.forbidden), *((box, GREY) for box in [limits.workspace] if box)]
    traces = _path_traces(xyz, found.issues)
    around = [
        *({**dict(trace), "showlegend": False} for trace in picture.data),
        *traces,
        *(_box(box, colour, arm.T_world_base.as_matrix()) for box, colour in boxes),
    ]
    shown = {**picture.layout, "showlegend": True}
    return (
        Figure(data=around, layout=shown, height_px=picture.height_px),
        Figure(data=[*traces, _names(xyz, runs)], layout={**shown, "scene": _close(xyz)}, height_px=picture.height_px),
    )


def _close(xyz: Array) -> Plot:
    """Return a scene round the path (n, 3), in its true proportions but nowhere flat."""
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    widest = max(float((high - low).max()), 1e-6)
    half = 0.5 * np.maximum(1.1 * (high - low), FLATTEST * widest)
    ends = np.stack([0.5 * (low + high) - half, 0.5 * (low + high) + half], axis=1) / MM
    scene: Plot = {f"{name}axis": axis(f"{name}, mm", ticks="", range=ends[k].tolist()) for k, name in enumerate("xyz")}
    ratio = dict(zip("xyz", (2.0 * half / widest).tolist(), strict=True))
    return {**scene, "aspectmode": "manual", "aspectratio": ratio}


def _path_traces(xyz: Array, issues: Sequence[PathIssue]) -> list[Plot]:
    """Return the path (n, 3) in green, and the ways to rows in trouble over it."""
    issues_of: dict[int, list[PathIssue]] = {}
    for issue in issues:
        issues_of.setdefault(issue.row, []).append(issue)
    data = [line_mm(xyz, GREEN, 6, "no trouble")]
    for kind in COLOURS:
        rows = sorted(row for row, there in issues_of.items() if _first_kind(there) is kind)
        if rows:
            data += _trouble(xyz, rows, kind, issues_of)
    return data


def _first_kind(issues: Sequence[PathIssue]) -> PathTrouble:
    kinds = {issue.trouble for issue in issues}
    return next(kind for kind in COLOURS if kind in kinds)


def _trouble(
    xyz: Array, rows: Sequence[int], kind: PathTrouble, issues_of: Mapping[int, Sequence[PathIssue]]
) -> list[Plot]:
    """Return the stretches to rows in trouble, and the rows themselves with what is wrong there."""
    colour, word = COLOURS[kind]
    gap = np.full((1, 3), np.nan)
    ways = np.concatenate([np.concatenate([xyz[[max(row - 1, 0), row]], gap]) for row in rows])
    points = xyz[list(rows)]
    texts = ["<br>".join(text(issue.text) for issue in issues_of[row]) for row in rows]
    marks = line_mm(points, colour, 1, word, mode="markers", marker={"size": 3, "color": colour})
    return [
        line_mm(ways, colour, 9, word, legendgroup=word, hoverinfo="skip"),
        {**marks, "text": texts, "hoverinfo": "text", "legendgroup": word, "showlegend": False},
    ]


def _names(xyz: Array, runs: Sequence[Sequence[PathIssue]]) -> Plot:
    """Return the names of start and end, and of the first row of each run that is away from others."""
    named = {0: "start", len(xyz) - 1: "end"}
    apart = NAMES_APART * float(np.ptp(xyz, axis=0).max())
    for run in runs[:MAX_TABLE]:
        row = run[0].row
        if np.linalg.norm(xyz[list(named)] - xyz[row], axis=1).min() > apart:
            named[row] = f"row {row}"
    rows = sorted(named)
    trace = line_mm(xyz[rows], INK, 1, "rows", mode="text", hoverinfo="skip", showlegend=False)
    return {**trace, "text": [named[row] for row in rows], "textposition": "top center"}


def _box(box: Box, colour: str, T_world_base: Array) -> Plot:
    """Return the twelve edges of a box in base axes."""
    walk = [0, 1, 3, 2, 0, 4, 5, 7, 6, 4]
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
    edges = [corners[walk]]
    for a, b in ((1, 5), (3, 7), (2, 6)):
        edges += [np.full((1, 3), np.nan), corners[[a, b]]]
    points = box.lower_m + np.concatenate(edges) * (box.upper_m - box.lower_m)
    return line_mm(points @ T_world_base[:3, :3].T + T_world_base[:3, 3], colour, 3, text(box.name), hoverinfo="name")


def _joints(path: TaughtPath, arm: Arm, limits: Limits, found: PathCheck) -> list[Figure]:
    bounds = joint_bounds(arm, limits)
    s = path.length_m[: len(found.q)] / MM
    middle, half = 0.5 * (bounds.lower + bounds.upper), 0.5 * (bounds.upper - bounds.lower)
    share = np.where(np.isfinite(half), (found.q - middle) / np.where(np.isfinite(half), half, 1.0), np.nan)
    speed = found.joint_speed / bounds.speed
    return [
        _shares(arm, s, share, "share of its range", (-1.0, 1.0)),
        _shares(arm, s[1:], speed, "share of its speed", (0.0, 1.0)),
    ]


def _shares(arm: Arm, s: Array, share: Array, title: str, ends: tuple[float, float]) -> Figure:
    data: list[Plot] = []
    for i, joint in enumerate(arm.joints):
        if np.isfinite(share[:, i]).any():
            rows = thinned(share[:, i])
            colour = JOINT_COLOURS[i % len(JOINT_COLOURS)]
            line = {"color": colour, "width": 2}
            data.append({"type": "scatter", "x": s[rows], "y": share[rows, i], "name": text(joint.name), "line": line})
    for end in ends:
        line = {"color": RED, "width": 1, "dash": "dash"}
        data.append({"type": "scatter", "x": s[[0, -1]], "y": np.full(2, end), "line": line, "showlegend": False})
    for trace in data:
        trace["mode"] = "lines"
    return Figure(data=data, layout=layout(xaxis=axis("length along the path, mm"), yaxis=axis(title)), height_px=320)
