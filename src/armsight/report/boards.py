"""Boards of a calibration: where each one was before the cameras, and pictures of some with their points."""

from __future__ import annotations

import base64
from collections.abc import Sequence

import numpy as np

from armsight.arrays import Array
from armsight.report.figures import BLUE, INK, Figure, layout, short_names
from armsight.report.html import Page, text
from armsight.report.run import BoardPicture, BoardViews
from armsight.report.scene import line, pyramid, scene_axes
from armsight.units import MM, figure_of

MAX_PICTURES = 12
"""Pictures of boards in a report: 15 kB each, and all are seen without scrolling for long."""

LEVELS = ((1.0, "#3ddc84"), (2.0, "#ffd54a"), (3.0, "#ff9f43"))
"""Residual over the RMS up to which a point is marked so; beyond the last one it is WORST."""
WORST = "#ff4d4d"

SCALE = ((0.0, "#2a8fa0"), (0.5, "#d9a52b"), (1.0, "#c23b3b"))
"""Colours of boards from the best view to the worst."""

CAMERA_SHARE = 0.12
"""Length of a camera's pyramid over the distance of the boards."""


def add_boards(page: Page, views: BoardViews) -> None:
    """Add the boards in space, and the pictures of the worst, the best and some between."""
    if not views.T_parent_board:
        return
    page.add(
        "Boards before the cameras",
        f"Where each board was, in the axes of {views.parent}; the colour tells its RMS, and pointing at one its name. "
        "Boards near and far, and tilted to all sides, tell focal length and lens apart.",
        page.plot(boards_figure(views)),
    )
    kept = sorted({k for k, _ in views.pictures})
    shown = [kept[i] for i in chosen_views([views.rms_px[k] for k in kept], _room(views))]
    figures = [_picture(picture) for k in shown for at, picture in views.pictures if at == k]
    if figures:
        page.add(
            "Boards and their points",
            "The worst, the best and some between. A point's colour is its residual beside the RMS of its picture: "
            "green up to it, yellow to twice, orange to three times, red beyond.",
            f'<div class="boards">{"".join(figures)}</div>',
        )


def _room(views: BoardViews) -> int:
    """Return how many views have room: each picture of a view counts."""
    seen = [k for k, _ in views.pictures]
    return MAX_PICTURES // max(1, max((seen.count(k) for k in set(seen)), default=1))


def chosen_views(rms_px: Sequence[float], limit: int = MAX_PICTURES) -> list[int]:
    """Return the positions of at most limit views, the worst first: a third the worst, a third the best, some
    between."""
    order: list[int] = np.argsort(-np.asarray(rms_px, float), kind="stable").tolist()
    if len(order) <= limit:
        return order
    ends = max(1, limit // 3)
    between = np.linspace(ends, len(order) - ends - 1, limit - 2 * ends).round().astype(int).tolist()
    return [order[i] for i in [*range(ends), *dict.fromkeys(between), *range(len(order) - ends, len(order))]]


def boards_figure(views: BoardViews) -> Figure:
    """Return the boards' edges and the cameras in space, in mm."""
    middles = np.array([np.asarray(T.apply(views.outline_m)).mean(axis=0) for T in views.T_parent_board])
    eyes = np.array([np.asarray(T.translation) for _, _, T in views.cameras])
    away = float(np.median(np.linalg.norm(middles - eyes.mean(axis=0), axis=1)))
    shade = _shades(np.asarray(views.rms_px, float))
    data = []
    closed = np.concatenate([views.outline_m, views.outline_m[:1]])
    for name, rms, colour, T in zip(short_names(views.names), views.rms_px, shade, views.T_parent_board, strict=True):
        hover = {"hovertemplate": f"{name}<br>{figure_of(rms, 'px')} RMS<extra></extra>", "showlegend": False}
        data.append(line(np.asarray(T.apply(closed)) / MM, name, {"color": colour, "width": 4}, **hover))
    stroke = {"color": INK, "width": 2}
    for name, camera, T in views.cameras:
        data.append(line(pyramid(camera, T, CAMERA_SHARE * away), text(name), stroke, hoverinfo="name"))
    shape = layout(
        scene=scene_axes("base" if "base" in views.parent else "rig"),
        uirevision=1,
    )
    if len(views.cameras) > LISTED:
        shape["showlegend"] = False
    return Figure(data=data, layout=shape, height_px=480)


LISTED = 4
"""Cameras up to which each stands in the legend."""


def _shades(rms: Array) -> list[str]:
    """Return a colour for each view between SCALE's, by its RMS; one colour where all are alike."""
    low, high = float(rms.min()), float(rms.max())
    if high <= 0.0 or high - low < 1e-9 * high:
        return [BLUE] * len(rms)
    at = (rms - low) / (high - low)
    knots = [value for value, _ in SCALE]
    parts = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for _, colour in SCALE])
    mixed = np.stack([np.interp(at, knots, parts[:, k]) for k in range(3)], axis=1).round().astype(int)
    return [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in mixed.tolist()]


def _picture(picture: BoardPicture) -> str:
    size = f"{picture.width} {picture.height}"
    unit = picture.width / 100.0
    rms = float(np.sqrt(np.mean(picture.residual_px**2))) if len(picture.residual_px) else 0.0
    marks = "".join(
        f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{0.9 * unit:.3g}" stroke="{_colour(residual, rms)}"/>'
        for (u, v), residual in zip(picture.uv_px.tolist(), picture.residual_px.tolist(), strict=True)
    )
    source = "data:image/webp;base64," + base64.b64encode(picture.webp).decode("ascii")
    caption = f"{short_names([picture.name])[0]}: {figure_of(rms, 'px')} RMS, {len(picture.uv_px)} points"
    return (
        f'<figure><svg viewBox="-0.5 -0.5 {size}" role="img" aria-label="{caption}"><image href="{source}" x="-0.5" '
        f'y="-0.5" width="{picture.width}" height="{picture.height}" preserveAspectRatio="none"/>'
        f'<g fill="none" stroke-width="{0.35 * unit:.3g}">{marks}</g></svg><figcaption>{caption}</figcaption></figure>'
    )


def _colour(residual: float, rms: float) -> str:
    return next((colour for times, colour in LEVELS if residual <= times * rms), WORST)
