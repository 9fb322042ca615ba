"""Plots of what a fit leaves, per camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from armsight.arrays import Array
from armsight.report.figures import BLUE, GREY, INK, ORANGE, Figure, Plot, axis, bars, layout, spread, subplot

BINS = 41

GAP = 0.14
"""Share of the figure between one camera's plots and the next's."""

STROKE = 0.02
"""Length of a stroke for a residual of the RMS, as a share of the image's width."""

WIDEST = 6.0
"""Times the RMS beyond which a residual is drawn at the edge of the plots: one wild point must not hide the rest."""


def pooled_rms(parts: Sequence[Array]) -> float | None:
    """Return the root mean square over all entries of all parts; None where there is none."""
    count = sum(part.size for part in parts)
    return float(np.sqrt(sum(float((part**2).sum()) for part in parts) / count)) if count else None


def distance_rms(parts: Sequence[Array]) -> float | None:
    """Return the root mean square distance of points (m, 2) of all parts; None where there is none."""
    rms = pooled_rms(parts)
    return None if rms is None else float(np.sqrt(2.0)) * rms


def residual_figure(residuals: Mapping[str, Array]) -> Figure:
    """Return per camera the cloud of residuals (m, 2) in px, and the histograms of both coordinates."""
    data: list[Plot] = []
    shape = layout(margin={"l": 56, "r": 16, "t": 34, "b": 44})
    notes = []
    limit = _limit(residuals)
    n = len(residuals)
    for i, (name, points) in enumerate(residuals.items()):
        height = (1.0 - GAP * (n - 1)) / n
        top = 1.0 - i * (height + GAP)
        domain = [max(0.0, top - height), top]
        cloud, shares = subplot(2 * i + 1), subplot(2 * i + 2)
        side: Plot = {"range": [-limit, limit], "constrain": "domain"}
        shape["xaxis" + cloud["xaxis"][1:]] = axis("Δu, px", domain=[0.0, 0.36], anchor=cloud["yaxis"], **side)
        shape["yaxis" + cloud["yaxis"][1:]] = axis(
            "Δv, px", domain=domain, anchor=cloud["xaxis"], scaleanchor=cloud["xaxis"], **side
        )
        shape["xaxis" + shares["xaxis"][1:]] = axis(
            "Δ, px", domain=[0.46, 1.0], anchor=shares["yaxis"], range=side["range"]
        )
        shape["yaxis" + shares["yaxis"][1:]] = axis("share", domain=domain, anchor=shares["xaxis"], tickformat=".0%")
        data += [_cloud(points, limit, cloud), *_bars(points, limit, shares, legend=i == 0)]
        notes.append(_note(name, top))
    shape["annotations"] = notes
    shape["legend"] = {**shape["legend"], "x": 0.46}
    return Figure(data=data, layout=shape, height_px=110 + 250 * n)


def _limit(residuals: Mapping[str, Array]) -> float:
    """Return the half width of the plots: all points, but at most WIDEST times the RMS."""
    largest = max((float(np.abs(points).max()) for points in residuals.values() if points.size), default=1.0)
    rms = pooled_rms(list(residuals.values())) or 1.0
    return max(1.05 * min(largest, WIDEST * rms), 1e-6)


def _note(name: str, top: float) -> Plot:
    return {
        "text": f"<b>{escape(name)}</b>",
        "x": 0.0,
        "y": top,
        "xref": "paper",
        "yref": "paper",
        "xanchor": "left",
        "yanchor": "bottom",
        "showarrow": False,
    }


def _cloud(points: Array, limit: float, axes: dict[str, str]) -> Plot:
    shown = np.clip(points[spread(points)], -limit, limit)
    return {
        "type": "scatter",
        "x": shown[:, 0],
        "y": shown[:, 1],
        **axes,
        "mode": "markers",
        "marker": {"size": 3.5, "color": BLUE, "opacity": 0.35},
        "hovertemplate": "%{x:.3f}, %{y:.3f} px<extra></extra>",
        "showlegend": False,
    }


def _bars(points: Array, limit: float, axes: dict[str, str], *, legend: bool) -> list[Plot]:
    """Return the histograms of u and v, and the normal curve with the RMS of both."""
    edges = np.linspace(-limit, limit, BINS + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    out: list[Plot] = []
    for axis_, colour in ((0, BLUE), (1, ORANGE)):
        count, _ = np.histogram(np.clip(points[:, axis_], -limit, limit), edges)
        share = count / max(1, len(points))
        style = {"name": "uv"[axis_], **axes, "opacity": 0.55, "showlegend": legend, "hoverinfo": "skip"}
        out.append(bars(middle, share, float(edges[1] - edges[0]), colour, **style))
    rms = pooled_rms([points])
    if rms:
        fine = np.linspace(-limit, limit, 161)
        curve = np.exp(-0.5 * (fine / rms) ** 2) / (rms * np.sqrt(2.0 * np.pi)) * (edges[1] - edges[0])
        line = {"color": INK, "width": 1.2, "dash": "dot"}
        out.append(
            {
                "type": "scatter",
                "x": fine,
                "y": curve,
                "mode": "lines",
                "line": line,
                "name": "normal, same RMS",
                **axes,
                "showlegend": legend,
                "hoverinfo": "skip",
            }
        )
    return out


def coverage_figure(uv_px: Array, residual_px: Array, width: int, height: int) -> Figure:
    """Return where in the image the points (m, 2) lay, with their residuals as enlarged strokes."""
    rms = pooled_rms([residual_px]) or 1.0
    scale = STROKE * width / rms
    keep = spread(uv_px)
    ends = uv_px[keep] + scale * residual_px[keep]
    x = np.stack([uv_px[keep, 0], ends[:, 0], np.full(len(keep), np.nan)], axis=1).ravel()
    y = np.stack([uv_px[keep, 1], ends[:, 1], np.full(len(keep), np.nan)], axis=1).ravel()
    data = [
        {"type": "scatter", "x": x, "y": y, "mode": "lines", "line": {"color": GREY, "width": 1}, "hoverinfo": "skip"},
        {
            "type": "scatter",
            "x": uv_px[keep, 0],
            "y": uv_px[keep, 1],
            "mode": "markers",
            "marker": {"size": 3, "color": BLUE},
            "hovertemplate": "u %{x:.1f}, v %{y:.1f}<extra></extra>",
        },
    ]
    shape = layout(
        showlegend=False,
        xaxis=axis("u, px", range=[-0.5, width - 0.5], constrain="domain", mirror=True),
        yaxis=axis("v, px", range=[height - 0.5, -0.5], scaleanchor="x", constrain="domain", mirror=True),
    )
    return Figure(data=data, layout=shape, height_px=380)
