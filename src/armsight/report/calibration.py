"""report.html of a calibration."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from armsight.calibrate.cameras.preconditions import image_share
from armsight.report.figures import BLUE, ORANGE, Figure, axis, bars, layout, named_ticks, short_names
from armsight.report.html import Card, Page, bullets, table, text
from armsight.report.residuals import STROKE, coverage_figure, pooled_rms, residual_figure
from armsight.report.run import CalibrationRun, CameraFit
from armsight.report.scene import add_boards
from armsight.units import MM, figure_of, with_deviation

LONG_TABLE = 12
"""Rows above which a table is set in two columns."""


def calibration_report(run: CalibrationRun, *, created: datetime | None = None) -> str:
    """Return the page of a calibration as HTML text that needs no other file."""
    page = Page(
        title=run.title,
        subtitle=run.subtitle or f"{run.n_used} of {run.n_images} {_noun(run)} of the {run.thing} {run.board}",
        verdict=run.verdict,
        cards=_cards(run),
    )
    _add_parameters(page, run)
    if run.alignment:
        page.add(
            "Alignment", "How the two views stand to each other.", table(["", ""], [list(r) for r in run.alignment])
        )
    _add_images(page, run)
    if run.boards is not None:
        add_boards(page, run.boards)
    _add_coverage(page, run)
    clouds = {fit.name: fit.residual_px for fit in run.cameras if len(fit.residual_px)}
    if clouds:
        page.add(
            "Residuals",
            "Detected point minus the model's. Round clouds about the centre are noise; other shapes are a lens, "
            "a board or a corner that does not fit.",
            page.plot(residual_figure(clouds)),
        )
    _add_rejected(page, run)
    rows = [[run.thing, run.board], *([name, value] for name, value in run.facts)]
    page.add("What went in", "", table(["", ""], rows))
    return page.html(created=created or datetime.now())


def _noun(run: CalibrationRun) -> str:
    return "pairs" if len(run.cameras) > 1 else "images"


def coverage(fit: CameraFit) -> float:
    """Return the share of the image that lies between the points (their convex hull)."""
    return image_share(fit.uv_px, fit.camera.width, fit.camera.height)


def _cards(run: CalibrationRun) -> list[Card]:
    cards = [
        Card(name=f"{_noun(run)} used", value=f"{run.n_used} of {run.n_images}", note=f"{len(run.rejected)} rejected"),
        Card(name="fit", value=figure_of(run.rms_px, "px"), note="RMS"),
    ]
    if run.holdout_rms_px is not None:
        cards.append(Card(name="left out", value=figure_of(run.holdout_rms_px, "px"), note="RMS, k-fold"))
    if run.holdout_epipolar_rms_px is not None or run.epipolar_rms_px is not None:
        held = run.holdout_epipolar_rms_px is not None
        value = run.holdout_epipolar_rms_px if held else run.epipolar_rms_px
        cards.append(
            Card(name="epipolar", value=figure_of(value, "px"), note="RMS, left out" if held else "RMS, in the fit")
        )
    if run.baseline_m is not None:
        cards.append(Card(name="baseline", value=figure_of(run.baseline_m / MM, "mm", digits=5)))
    if run.metric:
        first = next(iter(run.metric))
        shown = "rms_m" if "rms_m" in run.metric else first
        cards.append(
            Card(name="length on the board", value=figure_of(run.metric[shown] / MM, "mm"), note="RMS error, left out")
        )
    cards += [
        Card(name=f"coverage, {fit.name}", value=f"{100 * coverage(fit):.0f} %", note="of the image")
        for fit in run.cameras
        if len(fit.uv_px)
    ]
    return cards


def _add_parameters(page: Page, run: CalibrationRun) -> None:
    rows = []
    for parameter in run.parameters:
        value, std = with_deviation(parameter.value, parameter.std)
        rows.append([parameter.name, value, std, parameter.unit])
    half = len(rows) if len(rows) <= LONG_TABLE else (len(rows) + 1) // 2
    header = ["parameter", "value", "standard deviation", "unit"]
    pieces = [table(header, piece, numbers=(1, 2)) for piece in (rows[:half], rows[half:]) if piece]
    parts = [f'<div class="pair">{"".join(pieces)}</div>']
    if run.metric:
        lengths = [[_metric_name(name), f"{value / MM:.4f}"] for name, value in run.metric.items()]
        metric = table(["lengths on the board, measured by the rig", "mm"], lengths, numbers=(1,))
        parts.append(f'<div class="pair">{metric}</div>')
    if run.advice:
        parts.append(f"<p>What would make it better:</p>{bullets(list(run.advice))}")
    page.add("Result", "Standard deviations are those of the fit: what this set of images leaves open.", *parts)


def _metric_name(name: str) -> str:
    words = name.removesuffix("_m").replace("_", " ")
    return {"expected": "expected", "mean": "mean", "rms": "RMS error", "board rms": "RMS of the rigid fit"}.get(
        words, words
    )


def _add_images(page: Page, run: CalibrationRun) -> None:
    """Add the RMS of each image, one bar per camera, or one per pair where the cameras share one figure."""
    fits = [fit for fit in run.cameras if fit.sources]
    shared = len(fits) > 1 and all(np.array_equal(fit.view_rms_px, fits[0].view_rms_px) for fit in fits)
    shown = fits[:1] if shared else fits
    if not shown:
        return
    width = 0.8 / len(shown)
    data = []
    for k, (fit, colour) in enumerate(zip(shown, (BLUE, ORANGE), strict=False)):
        at = np.arange(1.0, len(fit.sources) + 1.0) + (k - 0.5 * (len(shown) - 1)) * width
        hover = {"text": short_names(fit.sources), "hovertemplate": "%{text}<br>%{y:.3f} px<extra></extra>"}
        data.append(bars(at, fit.view_rms_px, 0.9 * width, colour, name=text(fit.name), **hover))
    shape = layout(
        showlegend=len(data) > 1,
        xaxis=axis("", **named_ticks(short_names(shown[0].sources))),
        yaxis=axis("RMS, px", rangemode="tozero"),
    )
    page.add(
        "Error of each image",
        "One that stands out was moved, blurred or badly detected.",
        page.plot(Figure(data=data, layout=shape, height_px=320)),
    )


def _add_coverage(page: Page, run: CalibrationRun) -> None:
    fits = [fit for fit in run.cameras if len(fit.uv_px)]
    if not fits:
        return
    figures = []
    for fit in fits:
        figure = coverage_figure(fit.uv_px, fit.residual_px, fit.camera.width, fit.camera.height)
        scale = STROKE * fit.camera.width / (pooled_rms([fit.residual_px]) or 1.0)
        caption = f"{fit.name}, residuals {scale:.0f} times enlarged"
        figures.append(f"<figure>{page.plot(figure)}<figcaption>{text(caption)}</figcaption></figure>")
    page.add(
        "Coverage of the image",
        "Each dot is a point of the board in some image, each stroke its residual. The lens is known where dots are; "
        "strokes that lean the same way side by side are lens that the model misses.",
        f'<div class="pair">{"".join(figures)}</div>',
    )


def _add_rejected(page: Page, run: CalibrationRun) -> None:
    if not run.rejected:
        page.add("Rejected", "Nothing: every image was used.")
        return
    page.add(
        "Rejected", "Not in the fit, each with its reason.", table(["image", "why"], [[s, w] for s, w in run.rejected])
    )
