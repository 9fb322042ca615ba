"""report.html of a calibration of one camera or of some."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cameras import CameraCalibration, CamerasCalibration, StereoCalibration
from armsight.calibrate.cameras.preconditions import image_share
from armsight.calibrate.mirrors.result import MirrorsOutput
from armsight.optics import SIDES, Camera
from armsight.records import NamedCovariance
from armsight.report.figures import BLUE, Figure, axis, bars, layout, named_ticks, short_names
from armsight.report.html import Card, Page, bullets, table, text
from armsight.report.residuals import STROKE, coverage_figure, pooled_rms, residual_figure
from armsight.report.run import BoardViews
from armsight.report.scene import add_boards
from armsight.units import MM, figure_of, with_deviation

Done = CameraCalibration | StereoCalibration | CamerasCalibration

LONG_TABLE = 12
"""Rows above which a table is set in two columns."""


def calibration_report(
    done: Done, shown: str, boards: BoardViews | None = None, *, facts: Sequence[tuple[str, str]] = ()
) -> str:
    """Return the page of a calibration as HTML text that needs no other file.

    shown: what the images show, in words. boards: where it was, with pictures. facts: more lines for what went in.
    """
    pair, noun, n, thing = _words(done)
    page = Page(
        title=f"Calibration of a {pair}",
        subtitle=f"{done.n_used} of {n} {noun} of the {thing} {shown}",
        verdict=done.verdict_,
        cards=_cards(done),
    )
    metric = _metric(done)
    _add_parameters(page, done, metric)
    if isinstance(done, StereoCalibration):
        plate = done.plate_words() if isinstance(done, MirrorsOutput) else ()
        rows = [[name, value] for name, value in (*alignment_lines(done), *plate)]
        page.add("Alignment", "How the two views stand to each other.", table(["", ""], rows))
    _add_images(page, done)
    if boards is not None:
        add_boards(page, boards)
    _add_coverage(page, done)
    clouds = {name: left for name, (_, _, left) in _cameras(done).items() if len(left)}
    if clouds:
        page.add(
            "Residuals",
            "Detected point minus the model's. Round clouds about the centre are noise; other shapes are a lens, "
            "a board or a corner that does not fit.",
            page.plot(residual_figure(clouds)),
        )
    _add_rejected(page, done.rejected)
    page.add("What went in", "", table(["", ""], [[thing, shown], *([name, value] for name, value in facts)]))
    return page.html()


def _words(done: Done) -> tuple[str, str, int, str]:
    """Return what was calibrated, from how many images or pairs, and what they show."""
    if isinstance(done, CameraCalibration):
        return "camera", "images", done.n_images, "board"
    if isinstance(done, CamerasCalibration):
        return f"rig of {len(done.rig.names)} cameras", "moments", done.n_moments, "board"
    return "mirror rig" if isinstance(done, MirrorsOutput) else "pair of cameras", "pairs", done.n_pairs, done.thing


def _cameras(done: Done) -> dict[str, tuple[Camera, Array, Array]]:
    """Return each camera by name, with every point used (n, 2) and its residual (n, 2), measured minus model."""
    clouds = done.clouds()
    if isinstance(done, CameraCalibration):
        return {name: (done.camera, uv, -left) for name, (uv, left) in clouds.items()}
    if isinstance(done, CamerasCalibration):
        known = done.cameras
    else:
        known = {side: done.pair_rig().camera(side) for side in clouds}
    return {name: (known[name], uv, -left) for name, (uv, left) in clouds.items()}


def _metric(done: Done) -> dict[str, float]:
    """Return lengths on the board, as the rig measures them on pairs left out of the fit, in m by name."""
    if not isinstance(done, StereoCalibration) or not done.metric_is_left_out:
        return {}
    return {name: m for name, m in done.metric.items() if m is not None}


def alignment_lines(done: StereoCalibration) -> list[tuple[str, str]]:
    """Return how parallel the pair stands, in words (Kapucu's alignment); as many digits as the standard deviations
    allow."""
    found = done.alignment
    std = found.std or {}

    def line(words: str, name: str, unit: str, scale: float) -> tuple[str, str]:
        value, deviation = with_deviation(scale * getattr(found, name), scale * std[name] if name in std else None)
        return words, f"{value} +- {deviation} {unit}" if name in std else f"{value} {unit}"

    return [
        line("axes turn towards each other by", "convergence_rad", "mrad", 1e3),
        line("right axis points below the left one by", "vertical_rad", "mrad", 1e3),
        line("right image lower at infinity by", "vertical_px", "px", 1.0),
        line("right image turned by", "roll_rad", "mrad", 1e3),
        line("right camera lower by", "height_m", "mm", 1e3),
        line("right camera further forward by", "advance_m", "mm", 1e3),
    ]


def _cards(done: Done) -> list[Card]:
    _, noun, n, _ = _words(done)
    cards = [
        Card(f"{noun} used", f"{done.n_used} of {n}", f"{len(done.rejected)} rejected"),
        Card("fit", figure_of(done.rms_px, "px"), "RMS"),
    ]
    if done.holdout_rms_px is not None:
        cards.append(Card("left out", figure_of(done.holdout_rms_px, "px"), "RMS, k-fold"))
    if isinstance(done, StereoCalibration):
        held = done.holdout_epipolar_rms_px
        value = done.epipolar_rms_px if held is None else held
        cards += [
            Card("epipolar", figure_of(value, "px"), "RMS, in the fit" if held is None else "RMS, left out"),
            Card("baseline", figure_of(done.pair_rig().baseline_m / MM, "mm", digits=5)),
        ]
    metric = _metric(done)
    if metric:
        value = metric.get("rms_m", next(iter(metric.values())))
        cards.append(Card("length on the board", figure_of(value / MM, "mm"), "RMS error, left out"))
    for name, (camera, uv_px, _) in _cameras(done).items():
        if len(uv_px):
            share = image_share(uv_px, camera.width, camera.height)
            cards.append(Card(f"coverage, {name}", f"{100 * share:.0f} %", "of the image"))
    return cards


def _parameters(done: Done) -> list[list[str]]:
    """Return the rows of the table: name, value, standard deviation and unit."""
    if isinstance(done, CameraCalibration):
        return _intrinsics("", done.camera, done.covariance)
    if isinstance(done, CamerasCalibration):
        return [row for name, camera in done.cameras.items() for row in _mounted(done, name, camera)]
    rig = done.pair_rig()
    rows = [["baseline", *with_deviation(rig.baseline_m * 1e3, done.baseline_std_m * 1e3), "mm"]]
    return rows + [row for side in SIDES for row in _intrinsics(f"{side}.", rig.camera(side), rig.covariance)]


def _mounted(done: CamerasCalibration, name: str, camera: Camera) -> list[list[str]]:
    """Return the rows of one camera of some: lens, place, and how late its clock is."""
    std, late = done.std, done.delay_s[name]
    rows = _intrinsics(f"{name}.", camera, done.solved.covariance)
    for along, at_m in zip("xyz", done.position_m[name], strict=True):
        doubt = std.get(f"{name}.t{along}_m")
        rows.append([f"{name} {along}", *with_deviation(at_m / MM, None if doubt is None else doubt / MM), "mm"])
    if late is not None and f"{name}.delay_s" in std:
        rows.append([f"{name} late by", *with_deviation(1e3 * late, 1e3 * std[f"{name}.delay_s"]), "ms"])
    return rows


def _intrinsics(prefix: str, camera: Camera, covariance: NamedCovariance | None) -> list[list[str]]:
    std: Mapping[str, float] = covariance.std() if covariance else {}
    return [
        [f"{prefix}{name}", *with_deviation(value, std.get(f"{prefix}{name}")), "px" if i < 5 else ""]
        for i, (name, value) in enumerate(camera.named.items())
    ]


def _add_parameters(page: Page, done: Done, metric: Mapping[str, float]) -> None:
    rows = _parameters(done)
    half = len(rows) if len(rows) <= LONG_TABLE else (len(rows) + 1) // 2
    header = ["parameter", "value", "standard deviation", "unit"]
    pieces = [table(header, piece, numbers=(1, 2)) for piece in (rows[:half], rows[half:]) if piece]
    parts = [f'<div class="pair">{"".join(pieces)}</div>']
    if metric:
        lengths = [[_metric_name(name), f"{value / MM:.4f}"] for name, value in metric.items()]
        shown = table(["lengths on the board, measured by the rig", "mm"], lengths, numbers=(1,))
        parts.append(f'<div class="pair">{shown}</div>')
    if done.advice:
        parts.append(f"<p>What would make it better:</p>{bullets(list(done.advice))}")
    page.add("Result", "Standard deviations are those of the fit: what this set of images leaves open.", *parts)


def _metric_name(name: str) -> str:
    words = name.removesuffix("_m").replace("_", " ")
    return {"expected": "expected", "mean": "mean", "rms": "RMS error", "board rms": "RMS of the rigid fit"}.get(
        words, words
    )


def _add_images(page: Page, done: Done) -> None:
    """Add the RMS of each image, or of each pair, under the name of its left image."""
    sources = done.sources if isinstance(done, CameraCalibration) else tuple(names[0] for names in done.sources)
    if not sources:
        return
    hover = {"text": short_names(sources), "hovertemplate": "%{text}<br>%{y:.3f} px<extra></extra>"}
    at, rms_px = np.arange(1.0, len(sources) + 1.0), np.asarray(done.view_rms_px, float)
    shape = layout(
        showlegend=False,
        xaxis=axis("", **named_ticks(short_names(sources))),
        yaxis=axis("RMS, px", rangemode="tozero"),
    )
    data = [bars(at, rms_px, 0.9 * 0.8, BLUE, name=next(iter(_cameras(done))), **hover)]
    page.add(
        "Error of each image",
        "One that stands out was moved, blurred or badly detected.",
        page.plot(Figure(data=data, layout=shape, height_px=320)),
    )


def _add_coverage(page: Page, done: Done) -> None:
    figures = []
    for name, (camera, uv_px, residual_px) in _cameras(done).items():
        if len(uv_px):
            figure = coverage_figure(uv_px, residual_px, camera.width, camera.height)
            scale = STROKE * camera.width / (pooled_rms([residual_px]) or 1.0)
            caption = f"{name}, residuals {scale:.0f} times enlarged"
            figures.append(f"<figure>{page.plot(figure)}<figcaption>{text(caption)}</figcaption></figure>")
    if not figures:
        return
    page.add(
        "Coverage of the image",
        "Each dot is a point of the board in some image, each stroke its residual. The lens is known where dots are; "
        "strokes that lean the same way side by side are lens that the model misses.",
        f'<div class="pair">{"".join(figures)}</div>',
    )


def _add_rejected(page: Page, rejected: Sequence[tuple[str, str]]) -> None:
    if not rejected:
        page.add("Rejected", "Nothing: every image was used.")
        return
    rows = [[image, why] for image, why in rejected]
    page.add("Rejected", "Not in the fit, each with its reason.", table(["image", "why"], rows))
