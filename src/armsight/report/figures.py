"""Figures as plotly.js reads them, built as plain data; and how ten thousand points become a thousand."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

BLUE, ORANGE, GREEN, RED, GREY, INK = "#1f5fa8", "#d9822b", "#2e7d4f", "#c23b3b", "#9aa7b4", "#1c2733"
BAND = "rgba(31,95,168,0.22)"
FONT = 'system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif'

MAX_PLOTTED = 2000
"""Points of one line in a plot 1,000 px wide: each column of pixels gets its lowest and its highest."""

MAX_SCATTERED = 3000
"""Markers of one scatter plot; more are slow to draw and lie on each other."""

SIGNIFICANT = 8
"""Digits kept in a figure: a micrometre in ten metres."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """Traces and layout in plotly.js's terms, and the height in the page."""

    data: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any]
    height_px: int = 420


def layout(**more: Any) -> dict[str, Any]:
    """Return the layout that all figures share, with more of it or other."""
    return {
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "margin": {"l": 62, "r": 16, "t": 28, "b": 44},
        "hovermode": "closest",
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0, "xanchor": "left"},
        **more,
    }


def axis(title: str = "", **more: Any) -> dict[str, Any]:
    """Return an axis in the style of all figures."""
    return {
        "title": {"text": title, "standoff": 6},
        "gridcolor": "#e8edf2",
        "zerolinecolor": "#c9d3dc",
        "linecolor": "#c9d3dc",
        "showline": True,
        "ticks": "outside",
        "ticklen": 3,
        "tickcolor": "#c9d3dc",
        "automargin": True,
        **more,
    }


def place(k: int, over: int | None = None) -> dict[str, str]:
    """Return the axes of subplot k >= 1, its y axis number over where given: plotly calls the first ones x and y."""
    return {"xaxis": f"x{k if k > 1 else ''}", "yaxis": f"y{(over or k) if (over or k) > 1 else ''}"}


def json_text(value: Any) -> str:
    """Return value as JSON that can stand inside a script element; arrays are rounded, what is not finite is null."""
    text = json.dumps(_plain(value), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim == 1:
        return [float(f"{v:.{SIGNIFICANT}g}") if math.isfinite(v) else None for v in value.tolist()]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{SIGNIFICANT}g}") if math.isfinite(value) else None
    return value


def thinned(values: Array, limit: int = MAX_PLOTTED) -> Index:
    """Return the positions to plot of a long line (n,): all where n <= limit, else each bucket's least and greatest.

    NaN is left out of the choice, so outliers and gaps' edges survive.
    """
    n = len(values)
    if n <= limit:
        return np.arange(n)
    size = -(-2 * n // limit)  # of a bucket
    rows = -(-n // size)
    padded = np.full(rows * size, np.nan)
    padded[:n] = values
    buckets = padded.reshape(rows, size)
    known = np.isfinite(buckets)
    least = np.where(known, buckets, np.inf).argmin(axis=1)
    greatest = np.where(known, buckets, -np.inf).argmax(axis=1)
    start = size * np.arange(rows)
    some = known.any(axis=1)
    return np.unique(np.concatenate([[0, n - 1], (start + least)[some], (start + greatest)[some]]))


def spread(values: Array, limit: int = MAX_SCATTERED) -> Index:
    """Return the positions of a scatter (n, 2) to plot: evenly chosen, and the farthest ones always."""
    n = len(values)
    if n <= limit:
        return np.arange(n)
    far = np.argsort(-np.abs(values).max(axis=1))[: limit // 100]
    even = np.linspace(0, n - 1, limit - len(far)).astype(int)
    return np.unique(np.concatenate([far, even]))


def runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return [start, stop) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def band(x: Array, low: Array, high: Array, **more: Any) -> dict[str, Any]:
    """Return a filled band between low and high over x, one polygon per stretch without NaN."""
    xs: list[float | None] = []
    ys: list[float | None] = []
    for a, b in runs(np.isfinite(low) & np.isfinite(high)):
        xs += [*x[a:b].tolist(), *x[a:b][::-1].tolist(), None]
        ys += [*high[a:b].tolist(), *low[a:b][::-1].tolist(), None]
    return {
        "type": "scatter",
        "x": xs,
        "y": ys,
        "fill": "toself",
        "fillcolor": BAND,
        "line": {"width": 0},
        "mode": "lines",
        "hoverinfo": "skip",
        **more,
    }


def points_in_space(name: str, xyz: Array, marker: Mapping[str, Any], mode: str = "markers") -> dict[str, Any]:
    """Return the trace of points (n, 3), in the units of the axes."""
    x, y, z = xyz.T
    return {"type": "scatter3d", "mode": mode, "name": name, "x": x, "y": y, "z": z, "marker": marker}


def cloud_figure(xyz_m: Array, sigma_m: Array, measured_m: Array) -> Figure:
    """Return positions (m, 3) coloured by their standard deviations (m,), and the positions measured (k, 3)."""
    xyz, seen, shown = 1e3 * xyz_m, 1e3 * measured_m, np.where(np.isfinite(sigma_m), 1e3 * sigma_m, np.nan)
    colours = {"color": shown, "colorscale": "Viridis", "colorbar": {"title": {"text": "mm"}}}
    cloud = points_in_space("tool", xyz, {"size": 3, **colours})
    measured = points_in_space("measured", seen, {"size": 2, "color": INK, "symbol": "cross"})
    scene = {"aspectmode": "data", **{f"{a}axis": {"title": {"text": f"{a}, mm"}} for a in "xyz"}}
    return Figure(data=[cloud, measured], layout=layout(scene=scene), height_px=520)
