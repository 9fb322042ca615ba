"""Images with what was found in them drawn over, and what stood before the cameras: lights with rays, and boards."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.optics import Camera, Rig
from armsight.report.figures import BLUE, GREEN, GREY, INK, ORANGE, RED, Figure, Plot, axis, layout, short_names
from armsight.report.html import Page, text
from armsight.report.run import BoardPicture, BoardViews, MeasureRun, Sample
from armsight.units import MM, figure_of

LARGEST_IMAGE = 70_000
"""Bytes of an image in the page: six of them leave a report under 1.5 MB. A noisier one goes in as JPEG: WebP has half
the bytes and takes fifty times as long, more than measuring ten pairs."""

QUALITIES = (85, 75, 65, 55, 45, 35)

SMALLEST_PX = 400
"""Height of an image below which it is not made smaller, whatever its bytes."""

PNG_EFFORT = 3
"""zlib's level: 9 takes thirty times as long on a noisy frame and saves a tenth."""

ZOOM_PX = 24.0
"""Side of the square of the image that a zoom shows: wider than the largest spot at its usual size."""

MAX_ZOOMS = 6

LIT = "#3ddc84"
"""Of what was used: bright enough beside black and white alike."""


def data_uri(image: NDArray[np.uint8]) -> str:
    """Return an image as a PNG data URI; where that is larger than LARGEST_IMAGE, as JPEG, at half the size at last."""
    if _jpeg(image, QUALITIES[0]).size <= LARGEST_IMAGE:  # what is noisier is larger as PNG
        _, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_EFFORT])
        if png.size <= LARGEST_IMAGE:
            return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")
    while True:
        for quality in QUALITIES:
            jpeg = _jpeg(image, quality)
            if jpeg.size <= LARGEST_IMAGE:
                break
        if jpeg.size <= LARGEST_IMAGE or min(image.shape[:2]) < SMALLEST_PX:
            break
        image = np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return "data:image/jpeg;base64," + base64.b64encode(jpeg.tobytes()).decode("ascii")


def _jpeg(image: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], np.uint8)


def sample_figure(sample: Sample, number: int) -> str:
    """Return one image with circles round the matched spots, crosses on the rejected, and zooms below.

    number: makes the image's name in the page unique.
    """
    from armsight.measure.spots import CANDIDATE  # here, as other reports have no spots

    height, width = sample.image.shape[:2]
    name = f"image{number}"
    unit = width / 100.0  # marks keep their size on the screen whatever the image's
    marks = [_circle(u, v, r, spot, LIT, unit) for (u, v, r), spot in zip(_circles(sample), sample.names, strict=True)]
    marks += [
        _dot(u, v, why, unit) if why == CANDIDATE else _cross(u, v, why, unit) for u, v, why in sample.seen.rejected
    ]
    matched = {tuple(uv) for uv in sample.spots.uv_px.tolist()}
    marks += [
        _circle(u, v, max(1.6 * unit, 3.0 * size), "", ORANGE, unit)
        for (u, v), size in zip(sample.seen.uv_px.tolist(), sample.seen.size_px.tolist(), strict=True)
        if (u, v) not in matched
    ]
    image = (
        f'<image id="{name}" href="{data_uri(sample.image)}" x="-0.5" y="-0.5" width="{width}" height="{height}" '
        'style="image-rendering:pixelated"/>'
    )
    title = f"frame {sample.frame}, {sample.side}" + (f", {sample.source}" if sample.source else "")
    seen = len(sample.seen) + len(sample.seen.rejected)
    counts = f"{len(sample.names)} matched of {len(sample.seen)} measured, {seen} bright things in all"
    caption = f"{title}: {counts}" + (f". {sample.why}" if sample.why else "")
    return (
        f'<figure><svg viewBox="-0.5 -0.5 {width} {height}" role="img" aria-label="{text(title)}">{image}'
        f"{''.join(marks)}</svg>{_zooms(sample, name)}<figcaption>{text(caption)}</figcaption></figure>"
    )


def _circles(sample: Sample) -> list[tuple[float, float, float]]:
    unit = sample.image.shape[1] / 100.0
    return [
        (u, v, max(1.6 * unit, 3.0 * size))
        for (u, v), size in zip(sample.spots.uv_px.tolist(), sample.spots.size_px.tolist(), strict=True)
    ]


def _circle(u: float, v: float, radius: float, label: str, colour: str, unit: float) -> str:
    shown = (
        f'<text x="{u + 1.2 * radius:.2f}" y="{v - 0.8 * radius:.2f}" fill="#fff" stroke="#000" '
        f'stroke-width="{0.5 * unit:.3g}" paint-order="stroke" font-family="sans-serif" '
        f'font-size="{2.6 * unit:.3g}">{text(label)}</text>'
        if label
        else ""
    )
    circle = f'<circle cx="{u:.3f}" cy="{v:.3f}" r="{radius:.3f}" fill="none"'
    return (
        f'{circle} stroke="#000" stroke-opacity=".6" stroke-width="{0.9 * unit:.3g}"/>'
        f'{circle} stroke="{colour}" stroke-width="{0.45 * unit:.3g}"/>{shown}'
    )


def _dot(u: float, v: float, why: str, unit: float) -> str:
    return (
        f'<circle cx="{u:.2f}" cy="{v:.2f}" r="{0.6 * unit:.3g}" fill="none" stroke="{GREY}" '
        f'stroke-width="{0.25 * unit:.3g}"><title>{text(why)}</title></circle>'
    )


def _cross(u: float, v: float, why: str, unit: float) -> str:
    r = 1.2 * unit
    return (
        f'<path d="M{u - r:.2f} {v - r:.2f}L{u + r:.2f} {v + r:.2f}M{u - r:.2f} {v + r:.2f}L{u + r:.2f} {v - r:.2f}" '
        f'stroke="{RED}" stroke-width="{0.35 * unit:.3g}"><title>{text(why)}</title></path>'
    )


def _zooms(sample: Sample, name: str) -> str:
    """Return the first matched spots enlarged, with their measured centres."""
    if len(sample.names) > 2 * MAX_ZOOMS:
        return ""  # a board: the points are corners, not lights
    out = []
    for spot, (u, v), size in zip(
        sample.names[:MAX_ZOOMS], sample.spots.uv_px.tolist(), sample.spots.size_px.tolist(), strict=False
    ):
        half = max(ZOOM_PX / 2.0, 4.0 * size)
        arm, line = 0.35 * half, 0.04 * half
        out.append(
            f'<svg viewBox="{u - half:.2f} {v - half:.2f} {2 * half:.2f} {2 * half:.2f}" role="img" '
            f'aria-label="{text(spot)}"><use href="#{name}"/><path d="M{u - arm:.3f} {v:.3f}H{u + arm:.3f}'
            f'M{u:.3f} {v - arm:.3f}V{v + arm:.3f}" stroke="{LIT}" stroke-width="{line:.3g}"/>'
            f'<text x="{u - 0.92 * half:.2f}" y="{v - 0.62 * half:.2f}" fill="#fff" font-family="sans-serif" '
            f'font-size="{0.3 * half:.3g}">{text(spot)}</text></svg>'
        )
    return f'<div class="zooms">{"".join(out)}</div>' if out else ""


NAMED = 12
"""Lights up to which each gets its name and its rays; a board has too many."""


def line(xyz: Array, name: str, style: Plot, **more: Any) -> Plot:
    """Return a line in space through points (n, 3) in mm."""
    coordinates = {"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2]}
    return {"type": "scatter3d", **coordinates, "name": name, "mode": "lines", "line": style, **more}


def camera_line(rig: Rig, side: str, T_parent_rig: RigidTransform | None, *, depth_m: float) -> Plot:
    """Return a camera as a pyramid whose base is its image, depth_m away."""
    T = rig.T_rig_camera(side)
    T = T if T_parent_rig is None else T_parent_rig * T
    return line(pyramid(rig.camera(side), T, depth_m), f"{side} camera", {"color": INK, "width": 2})


def pyramid(camera: Camera, T_parent_camera: RigidTransform, depth_m: float) -> Array:
    """Return the edges (n, 3) in mm of a camera's pyramid in one stroke."""
    fx, fy, cx, cy = camera.intrinsics[:4]
    u, v = np.array([0.0, camera.width, camera.width, 0.0]), np.array([0.0, 0.0, camera.height, camera.height])
    base = np.stack([(u - cx) / fx * depth_m, (v - cy) / fy * depth_m, np.full(4, depth_m)], axis=1)  # (4, 3)
    order = np.array([(0.0, 0.0, 0.0), *base[[0, 1]], (0, 0, 0), *base[[1, 2]], (0, 0, 0), *base[[2, 3]], (0, 0, 0)])
    closed = np.vstack([order, base[[3, 0]], base[3], np.zeros(3)])
    return np.asarray(T_parent_camera.apply(closed)) / MM


def scene_axes(parent: str) -> Plot:
    """Return axes in mm fitted to the data: seen from behind the cameras in rig axes, else with z up."""
    scene: Plot = {f"{name}axis": axis(f"{name}, mm", ticks="") for name in "xyz"}
    scene["aspectmode"] = "data"
    behind = {"up": {"x": 0, "y": -1, "z": 0}, "eye": {"x": -0.85, "y": -0.7, "z": -1.45}}
    above = {"up": {"x": 0, "y": 0, "z": 1}, "eye": {"x": 1.1, "y": -1.3, "z": 0.75}}
    return {**scene, "camera": behind if parent == "rig" else above}


def scene_figure(run: MeasureRun) -> Figure | None:
    """Return the scene at the best-known full pose; None where there is none."""
    best = _best(run)
    if best is None or (run.parent != "rig" and run.T_parent_rig is None):
        return None
    T = np.asarray(run.poses[best].T_parent_target)
    xyz = run.target.xyz_m @ T[:3, :3].T + T[:3, 3]
    names = run.rig.names
    eyes = [_eye(run, name) for name in names]
    away = float(np.mean([np.linalg.norm(xyz.mean(axis=0) - eye) for eye in eyes]))
    data = [camera_line(run.rig, side, run.T_parent_rig, depth_m=0.1 * away) for side in names]
    if len(xyz) <= NAMED:
        for side, eye in zip(names, eyes, strict=True):
            rays = np.concatenate([np.stack([eye, point, eye]) for point in xyz]) / MM
            data.append(line(rays, f"rays, {side}", {"color": GREY, "width": 1}))
    lights = list(run.target.names) if len(xyz) <= NAMED else None
    marks = {"mode": "markers+text" if lights else "markers", "marker": {"size": 5, "color": ORANGE}, "text": lights}
    data.append(line(xyz / MM, f"target in frame {best}", {}, **marks))
    size = 0.08 * away
    axes = np.concatenate([np.stack([T[:3, 3], T[:3, 3] + size * T[:3, k], T[:3, 3]]) for k in range(3)])
    tips = T[:3, 3] + size * T[:3, :3].T
    data.append(line(axes / MM, "its axes", {"color": GREEN, "width": 4}))
    ends = {"mode": "text", "text": ["x", "y", "z"], "showlegend": False}
    data.append(line(tips / MM, "axes' names", {}, **ends))
    shape = layout(scene=scene_axes(run.parent), uirevision=1)
    return Figure(data=data, layout=shape, height_px=460)


def _best(run: MeasureRun) -> int | None:
    """Return the frame whose full pose is known best."""
    known = [
        (float(np.trace(pose.covariance[:3, :3])), i)
        for i, pose in enumerate(run.poses)
        if pose.status.size == 6 and pose.covariance is not None
    ]
    return min(known)[1] if known else None


def _eye(run: MeasureRun, side: str) -> Array:
    """Return where a camera is in the parent frame (3,)."""
    T = run.rig.T_rig_camera(side)
    return np.asarray((T if run.T_parent_rig is None else run.T_parent_rig * T).translation)


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
    source = "data:image/jpeg;base64," + base64.b64encode(picture.jpeg).decode("ascii")
    caption = f"{short_names([picture.name])[0]}: {figure_of(rms, 'px')} RMS, {len(picture.uv_px)} points"
    return (
        f'<figure><svg viewBox="-0.5 -0.5 {size}" role="img" aria-label="{caption}"><image href="{source}" x="-0.5" '
        f'y="-0.5" width="{picture.width}" height="{picture.height}" preserveAspectRatio="none"/>'
        f'<g fill="none" stroke-width="{0.35 * unit:.3g}">{marks}</g></svg><figcaption>{caption}</figcaption></figure>'
    )


def _colour(residual: float, rms: float) -> str:
    return next((colour for times, colour in LEVELS if residual <= times * rms), WORST)
