"""Figures as plotly.js reads them, as plain data; ten thousand points as a thousand; views in space; results' plots."""

from __future__ import annotations

import html
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Index
from armsight.columns import POSE6
from armsight.measure.track import PoseTrack
from armsight.shown import Bars
from armsight.units import MM, displayed_name

if TYPE_CHECKING:
    import plotly.graph_objects as go


Plot = dict[str, Any]
"""A trace, a layout, or a part of one, as plotly takes it."""

BLUE, ORANGE, GREEN, RED, GREY, INK = "#1f5fa8", "#d9822b", "#2e7d4f", "#c23b3b", "#9aa7b4", "#1c2733"
BAND = "rgba(31,95,168,0.22)"
FONT = 'system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif'

EDGE: Plot = {"mode": "lines", "line": {"width": 0}, "fillcolor": BAND, "hoverinfo": "skip", "showlegend": False}
"""How the edges of a band of standard deviations look."""

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


def trace(mode: str, name: str, *xyz: Any, **more: Any) -> Plot:
    """Return the trace of points, in the plane or in space, one sequence a coordinate; more: of plotly's keys."""
    kind = "scatter" if len(xyz) == 2 else "scatter3d"
    return {"type": kind, "mode": mode, "name": name, **dict(zip("xyz", xyz, strict=False)), **more}


def points_in_space(name: str, xyz: Array, marker: Plot, mode: str = "markers") -> Plot:
    """Return the trace of points (n, 3), in the units of the axes."""
    return trace(mode, name, *xyz.T, marker=marker)


def cloud_figure(xyz_m: Array, sigma_m: Array, measured_m: Array) -> Figure:
    """Return positions (m, 3) coloured by their standard deviations (m,), and the positions measured (k, 3)."""
    xyz, seen, shown = 1e3 * xyz_m, 1e3 * measured_m, np.where(np.isfinite(sigma_m), 1e3 * sigma_m, np.nan)
    colours = {"color": shown, "colorscale": "Viridis", "colorbar": {"title": {"text": "mm"}}}
    cloud = points_in_space("tool", xyz, {"size": 3, **colours})
    measured = points_in_space("measured", seen, {"size": 2, "color": INK})
    scene = {"aspectmode": "data", **{f"{a}axis": {"title": {"text": f"{a}, mm"}} for a in "xyz"}}
    return Figure(data=[cloud, measured], layout=layout(scene=scene), height_px=520)


TAN = math.tan(math.radians(22.5))
"""Half the height of plotly's view over the distance of the eye."""
BOTTOM, TOP, SIDE = -0.78, 0.94, 1.3
"""Where the box of the data may end in the view, in halves of its height: the axes' names stand below and beside it."""
LIMITS = ((-SIDE, SIDE), (BOTTOM, TOP))
PAD = 0.04
"""Room about the data, as a share of its longest side."""
DEFAULT_EYE, DEFAULT_UP = {"x": 1.25, "y": 1.25, "z": 1.25}, {"x": 0.0, "y": 0.0, "z": 1.0}
"""Where plotly's camera stands, and what is up for it, where nothing is said."""
DEFAULTS = (("eye", DEFAULT_EYE), ("up", DEFAULT_UP))


def fitted_scene(scene: Plot, data: Sequence[Plot]) -> Plot:
    """Return a scene to scale whose axes end where the data does, as large as its view at first takes it.

    plotly's own "data" lets a long thin thing run out of the picture. Traces that only the legend names do not count:
    the page goes back to it where one is called up. wide in it tells narrow pages how far to step back. Without data
    the scene is unchanged.
    """
    shown = [trace for trace in data if trace.get("visible") != "legendonly"]
    traces = [trace for trace in shown if trace.get("type") == "scatter3d"]
    none = np.empty(0)
    columns = [np.concatenate([none, *(np.asarray(trace[name], float).ravel() for trace in traces)]) for name in "xyz"]
    known = [values[np.isfinite(values)] for values in columns]
    if not all(values.size for values in known):
        return dict(scene)
    low, high = (np.array([end(values) for values in known]) for end in (np.min, np.max))
    pad = PAD * float(np.max(high - low)) or 1.0
    low, high = low - pad, high + pad
    camera = scene.get("camera", {})
    eye, up = (np.array([{**zero, **camera.get(name, {})}[k] for k in "xyz"]) for name, zero in DEFAULTS)
    size, center, wide = _fitted((high - low) / np.max(high - low), eye, up)
    axes = {
        f"{name}axis": {**scene.get(f"{name}axis", {}), "range": [float(low[k]), float(high[k])]}
        for k, name in enumerate("xyz")
    }
    placed = {"eye": _named(eye + center), "up": _named(up), "center": _named(center)}
    return {
        **scene,
        **axes,
        "aspectmode": "manual",
        "aspectratio": _named(size),
        "camera": {**camera, **placed},
        "wide": wide,
    }


def _fitted(shape: Array, eye: Array, up: Array) -> tuple[Array, Array, float]:
    """Return the size (3,) of a box of that shape (3,) that fills the view, what the eye looks at (3,), and how far the
    box reaches to the sides, in halves of the view's height."""
    distance = float(np.linalg.norm(eye))
    ahead = -eye / distance
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    above = np.cross(right, ahead)
    corners = 0.5 * shape * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # (8, 3)
    least, most = 0.0, 1.3 * distance / float(np.linalg.norm(shape))  # the box stays before the eye
    center, wide = np.zeros(3), SIDE
    for _ in range(30):
        scale = 0.5 * (least + most)
        reach = TAN * (distance + scale * corners @ ahead)  # half the view's height at each corner
        # the eye's shift (along right, above) that puts the corners at both ends equally far inside the view's ends
        ends = [(scale * corners @ axis, reach) for axis in (right, above)]
        shift = [_balance(at, reach, *limits) for (at, reach), limits in zip(ends, LIMITS, strict=True)]
        if all(room >= 0.0 for _, room in shift):
            least, center = scale, shift[0][0] * right + shift[1][0] * above
            wide = float(np.max(np.abs((ends[0][0] - shift[0][0]) / reach)))
        else:
            most = scale
    return least * shape, center, wide


def _balance(at: Array, reach: Array, low: float, high: float) -> tuple[float, float]:
    """Return the shift s with low reach <= at - s <= high reach at all corners, and how much room it leaves."""
    upper, lower = float(np.min(at - low * reach)), float(np.max(at - high * reach))
    return 0.5 * (upper + lower), upper - lower


def _named(vector: Array) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


def plot(record: Any) -> go.Figure:
    """Return a plotly figure of a result. Raises TypeError for one that has nothing to plot."""
    if isinstance(record, PoseTrack):
        return track_figure(record)
    if hasattr(record, "clouds"):
        return residual_figure(record.title, record.clouds())
    made = getattr(record, "bars", None)
    if made is None:
        raise TypeError(f"{type(record).__name__} has nothing to plot")
    return drawn(made())


def track_figure(track: PoseTrack) -> go.Figure:
    """Return a plotly figure: position (mm) and orientation (deg) over time with their 95 % bands."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    table = track.table()
    figure = make_subplots(rows=6, cols=1, shared_xaxes=True, vertical_spacing=0.02)
    for i, name in enumerate(POSE6, 1):
        label, unit, size = displayed_name(name)
        band = 1.96 / size * table[f"s{name}"]
        value = table[name] / size
        for sign, fill in ((-1.0, None), (1.0, "tonexty")):
            edge = go.Scatter(x=table["t_s"], y=value + sign * band, fill=fill, **EDGE)
            figure.add_trace(edge, row=i, col=1)
        figure.add_trace(go.Scatter(x=table["t_s"], y=value, name=label, mode="lines+markers"), row=i, col=1)
        figure.update_yaxes(title_text=f"{label}, {unit}", row=i, col=1)
    figure.update_xaxes(title_text="t, s", row=6, col=1)
    figure.update_layout(title=track.title, height=900, showlegend=False)
    return figure


def residual_figure(title: str, views: Mapping[str, tuple[NDArray[Any], NDArray[Any]]]) -> go.Figure:
    """Return a plotly figure of residuals (n, 2) over the image, px, one plot a camera."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=len(views), subplot_titles=list(views))
    for column, (uv, residual) in enumerate(views.values(), 1):
        size = np.linalg.norm(residual, axis=1)
        text = [f"({dx:+.3f}, {dy:+.3f}) px" for dx, dy in residual]
        marker = {"color": size, "size": 5, "colorscale": "Viridis", "colorbar": {"title": "px"}}
        trace = go.Scatter(x=uv[:, 0], y=uv[:, 1], mode="markers", marker=marker, text=text, showlegend=False)
        figure.add_trace(trace, row=1, col=column)
        figure.update_yaxes(autorange="reversed", scaleanchor=f"x{column if column > 1 else ''}", row=1, col=column)
    figure.update_layout(title=title)
    return figure


def drawn(bars: Bars) -> go.Figure:
    """Return bars as a plotly figure."""
    import plotly.graph_objects as go

    figure = go.Figure(go.Bar(x=list(bars.names), y=list(bars.values)))
    figure.update_layout(title=bars.title, xaxis_title=bars.x, yaxis_title=bars.y)
    return figure


def error_figure(title: str, error_m: NDArray[Any], names: Sequence[str] = ()) -> go.Figure:
    """Return a plotly figure of errors (n,) in mm by row; names: of the rows."""
    rows = list(names) or [str(row) for row in range(len(error_m))]
    return drawn(Bars(title, rows, (error_m / MM).tolist(), "row", "error, mm"))
