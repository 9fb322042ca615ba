"""Plots of results, drawn by plotly from what they say of themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from armsight.shown import Bars
from armsight.units import MM

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from numpy.typing import NDArray


def plot(record: Any) -> go.Figure:
    """Return a plotly figure of a result. Raises TypeError for one that has nothing to plot."""
    if hasattr(record, "clouds"):
        return residual_figure(record.title, record.clouds())
    made = getattr(record, "bars", None)
    if made is None:
        raise TypeError(f"{type(record).__name__} has nothing to plot")
    return drawn(made())


def drawn(bars: Bars) -> go.Figure:
    """Return bars as a plotly figure."""
    import plotly.graph_objects as go

    figure = go.Figure(go.Bar(x=list(bars.names), y=list(bars.values)))
    figure.update_layout(title=bars.title, xaxis_title=bars.x, yaxis_title=bars.y)
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


def error_figure(title: str, error_m: NDArray[Any], names: Sequence[str] = ()) -> go.Figure:
    """Return a plotly figure of errors (n,) in mm by row; names: of the rows."""
    rows = list(names) or [str(row) for row in range(len(error_m))]
    return drawn(Bars(title, rows, (error_m / MM).tolist(), "row", "error, mm"))
