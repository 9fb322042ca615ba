"""Views in space fitted to what they show: to scale, whole, and as large as the view takes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from armsight.arrays import Array
from armsight.report.figures import Plot

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
