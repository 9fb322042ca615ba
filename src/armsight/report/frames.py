"""Images with what was found in them drawn over, as SVG that stays sharp."""

from __future__ import annotations

import base64

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.measure.spots import CANDIDATE
from armsight.report.figures import GREY, ORANGE, RED
from armsight.report.html import text
from armsight.report.run import Sample

LARGEST_IMAGE = 55_000
"""Bytes of an image in the page: six of them leave a report under 1.5 MB. A noisier one goes in as WebP."""

WEBP_QUALITIES = (85, 70, 55, 40)

JPEG_SHARE = 1.8
"""Size of a JPEG over that of a WebP of the same quality, which takes fifty times as long to make: 1.8 to 2.1."""

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
    """Return an image as a PNG data URI; where that is larger than LARGEST_IMAGE, as WebP, at half the size at last."""
    if _jpeg_bytes(image, WEBP_QUALITIES[0]) <= JPEG_SHARE * LARGEST_IMAGE:  # what is noisier is larger as PNG
        _, png = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_EFFORT])
        if png.size <= LARGEST_IMAGE:
            return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")
    while True:
        for quality in WEBP_QUALITIES:
            if quality != WEBP_QUALITIES[-1] and _jpeg_bytes(image, quality) > JPEG_SHARE * LARGEST_IMAGE:
                continue
            _, webp = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])
            if webp.size <= LARGEST_IMAGE:
                break
        if webp.size <= LARGEST_IMAGE or min(image.shape[:2]) < SMALLEST_PX:
            break
        image = np.asarray(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return "data:image/webp;base64," + base64.b64encode(webp.tobytes()).decode("ascii")


def _jpeg_bytes(image: NDArray[np.uint8], quality: int) -> int:
    return int(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].size)


def sample_figure(sample: Sample, number: int) -> str:
    """Return one image with circles round the matched spots, crosses on the rejected, and zooms below.

    number: makes the image's name in the page unique.
    """
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
