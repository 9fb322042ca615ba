"""Figures as plotly.js reads them, built as plain data; and how ten thousand points become a thousand."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Index

Plot = dict[str, Any]
"""A trace, a layout, or a part of one, as plotly takes it."""

BLUE, ORANGE, GREEN, RED, GREY, INK = "#1f5fa8", "#d9822b", "#2e7d4f", "#c23b3b", "#9aa7b4", "#1c2733"
BAND = "rgba(31,95,168,0.22)"
FONT = 'system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif'

MAX_PLOTTED = 1000
"""Points of one line in a plot 500 px wide: each column of pixels gets its lowest and its highest."""

MAX_SCATTERED = 3000
"""Markers of one scatter plot; more are slow to draw and lie on each other."""

SIGNIFICANT = 8
"""Digits kept of a single number."""

FINEST = 1e-5
"""Steps to which an array is rounded, as a share of its range: a hundredth of a pixel."""

LONGEST = 18
"""Letters of a file's name on an axis."""

MAX_NAMED = 20
"""Names on an axis: upright, they stand clear of each other on a telephone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """Traces and layout in plotly.js's terms, and the height in the page."""

    data: Sequence[Plot]
    layout: Plot
    height_px: int = 420


def layout(**more: Any) -> Plot:
    """Return the layout that all figures share, with more of it or other."""
    return {
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "margin": {"l": 62, "r": 16, "t": 28, "b": 44},
        "hovermode": "closest",
        "legend": {
            "orientation": "h",
            "y": 1.0,
            "yanchor": "bottom",
            "x": 0.0,
            "xanchor": "left",
            "itemsizing": "constant",
        },
        **more,
    }


def axis(title: str = "", **more: Any) -> Plot:
    """Return an axis in the style of all figures."""
    return {
        "title": {"text": title, "standoff": 6},
        "gridcolor": "#e8edf2",
        "zerolinecolor": "#c9d3dc",
        "linecolor": "#c9d3dc",
        "showline": True,
        "exponentformat": "power",
        "ticks": "outside",
        "ticklen": 3,
        "tickcolor": "#c9d3dc",
        "automargin": True,
        **more,
    }


def subplot(k: int, over: int | None = None) -> dict[str, str]:
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
        return _rounded(value)
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{SIGNIFICANT}g}") if math.isfinite(value) else None
    return value


def _rounded(values: Array) -> list[float | None]:
    """Return an array to FINEST of its range, which keeps moments apart on a clock that counts from 1970 too."""
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if known.size else 0.0
    if span > 0.0:
        values = np.round(values, math.ceil(-math.log10(FINEST * span)))
    return [float(f"{v:.15g}") if math.isfinite(v) else None for v in values.tolist()]


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


def band(x: Array, low: Array, high: Array, **more: Any) -> Plot:
    """Return a filled band between low and high over x, one polygon per stretch without NaN."""
    xs: list[Array] = [np.empty(0)]
    ys: list[Array] = [np.empty(0)]
    for a, b in runs(np.isfinite(low) & np.isfinite(high)):
        xs += [x[a:b], x[a:b][::-1], np.array([np.nan])]
        ys += [high[a:b], low[a:b][::-1], np.array([np.nan])]
    return {
        "type": "scatter",
        "x": np.concatenate(xs),
        "y": np.concatenate(ys),
        "fill": "toself",
        "fillcolor": BAND,
        "line": {"width": 0},
        "mode": "lines",
        "hoverinfo": "skip",
        **more,
    }


def short_names(sources: Sequence[str]) -> list[str]:
    """Return the files' names without their folders, so short that they stand beside each other, safe as markup."""
    names = [PurePath(source.replace("\\", "/")).name or source for source in sources]
    return [html.escape(name if len(name) <= LONGEST else f"…{name[1 - LONGEST :]}") for name in names]


def named_ticks(names: Sequence[str]) -> Plot:
    """Return the ticks of an axis on which name k stands at k + 1: upright and thinned, so that none overlap."""
    every = max(1, -(-len(names) // MAX_NAMED))
    at = list(range(0, len(names), every))
    return {
        "tickmode": "array",
        "tickvals": [k + 1 for k in at],
        "ticktext": [names[k] for k in at],
        "tickangle": -90,
        "range": [0.4, len(names) + 0.6],
        "tickfont": {"size": 10},
    }


def bars(x: Array, heights: Array, width: float, colour: str, **more: Any) -> Plot:
    """Return bars of a width about the places x (n,), as filled shapes: the bundle draws scatter plots only.

    Pointing at a bar's corner tells its height; texts (n,) in `text` are told with it.
    """
    half = 0.5 * width
    xs = np.stack([x - half, x - half, x + half, x + half, np.full(len(x), np.nan)], axis=1).ravel()
    zero = np.zeros(len(x))
    ys = np.stack([zero, heights, heights, zero, np.full(len(x), np.nan)], axis=1).ravel()
    hover = {"text": [word for word in more.pop("text") for _ in range(5)]} if "text" in more else {}
    shape = {"mode": "lines", "line": {"width": 0, "color": colour}, "fill": "toself", "fillcolor": colour}
    shape["hoveron"] = "points"
    return {"type": "scatter", "x": xs, "y": ys, **shape, **hover, **more}


def points_in_space(name: str, xyz: Array, marker: Plot, mode: str = "markers") -> Plot:
    """Return the trace of points (n, 3), in the units of the axes."""
    x, y, z = xyz.T
    return {"type": "scatter3d", "mode": mode, "name": name, "x": x, "y": y, "z": z, "marker": marker}


def cloud_figure(xyz_m: Array, sigma_m: Array, measured_m: Array) -> Figure:
    """Return positions (m, 3) coloured by their standard deviations (m,), and the positions measured (k, 3)."""
    xyz, seen, shown = 1e3 * xyz_m, 1e3 * measured_m, np.where(np.isfinite(sigma_m), 1e3 * sigma_m, np.nan)
    colours = {"color": shown, "colorscale": "Viridis", "colorbar": {"title": {"text": "mm"}}}
    cloud = points_in_space("tool", xyz, {"size": 3, **colours})
    measured = points_in_space("measured", seen, {"size": 2, "color": INK})
    scene = {"aspectmode": "data", **{f"{a}axis": {"title": {"text": f"{a}, mm"}} for a in "xyz"}}
    return Figure(data=[cloud, measured], layout=layout(scene=scene), height_px=520)
