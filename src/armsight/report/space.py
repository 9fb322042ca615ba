"""Views in space fitted to what they show: to scale, whole, from any side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DIAGONAL = 0.75
"""Diagonal of the box of the data over the eye's distance: plotly's view is 0.83 of that distance high."""
PAD = 0.04
"""Room about the data, as a share of its longest side."""
DEFAULT_EYE = {"x": 1.25, "y": 1.25, "z": 1.25}
"""Where plotly's camera stands where nothing is said."""


def fitted_scene(scene: Mapping[str, Any], data: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return a scene to scale whose axes end where the data does, so small that all of it is in the view.

    plotly's own "data" lets a long thin thing run out of the picture. Traces that only the legend names do not count:
    the page goes back to it where one is called up. Without data the scene is unchanged.
    """
    shown = [trace for trace in data if trace.get("visible") != "legendonly"]
    traces = [trace for trace in shown if trace.get("type") == "scatter3d"]
    none = np.empty(0)
    places = [np.concatenate([none, *(np.asarray(trace[name], float).ravel() for trace in traces)]) for name in "xyz"]
    known = [values[np.isfinite(values)] for values in places]
    if not all(values.size for values in known):
        return dict(scene)
    low, high = (np.array([end(values) for values in known]) for end in (np.min, np.max))
    pad = PAD * float(np.max(high - low)) or 1.0
    low, high = low - pad, high + pad
    eye = scene.get("camera", {}).get("eye", DEFAULT_EYE)
    size = (high - low) / np.linalg.norm(high - low) * DIAGONAL * np.linalg.norm([eye[name] for name in "xyz"])
    axes = {
        f"{name}axis": {**scene.get(f"{name}axis", {}), "range": [float(low[k]), float(high[k])]}
        for k, name in enumerate("xyz")
    }
    ratio = dict(zip("xyz", size.tolist(), strict=True))
    return {**scene, **axes, "aspectmode": "manual", "aspectratio": ratio}
