"""Plots of results, drawn by plotly from what they say of themselves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from armsight.shown import Bars
from armsight.units import MM

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from numpy.typing import NDArray


def plot(record: Any) -> go.Figure:
    """Return a plotly figure of a result. Raises TypeError for one that has nothing to plot."""
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


def error_figure(title: str, error_m: NDArray[Any], names: Sequence[str] = ()) -> go.Figure:
    """Return a plotly figure of errors (n,) in mm by row; names: of the rows."""
    rows = list(names) or [str(row) for row in range(len(error_m))]
    return drawn(Bars(title, rows, (error_m / MM).tolist(), "row", "error, mm"))
