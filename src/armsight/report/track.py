"""The plots of a track: in space, over time, and how well it is known."""

from __future__ import annotations

from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.measure.series import Series
from armsight.records import PoseStatus
from armsight.report.figures import (
    BAND,
    BLUE,
    GREY,
    MAX_PLOTTED,
    ORANGE,
    RED,
    Figure,
    Plot,
    axis,
    band,
    layout,
    runs,
    subplot,
    thinned,
)
from armsight.report.run import MeasureRun
from armsight.report.scene import camera_line, line, scene_axes
from armsight.units import MM

TITLES = ("x, mm", "y, mm", "z, mm", "rx, °", "ry, °", "rz, °")

WITHIN_95 = 1.96

MARKED = 400
"""Frames up to which every one gets a mark on the line."""

FAR = 3.0
"""A track seen from farther than this many times its own size would be a dot beside the cameras: they start hidden."""


def track_figure(run: MeasureRun, series: Series) -> Figure:
    """Return the track in space, with the truth where there is one and the cameras where the axes are the rig's."""
    position = series.where(PoseStatus.POSITION_ONLY)
    xyz = series.full()[0][:, :3]
    every = np.unique(np.linspace(0, len(xyz) - 1, MAX_PLOTTED).astype(int))
    data: list[Plot] = []
    mode = "markers" if series.apart else "lines+markers"
    if run.truth is not None:
        true = np.array([np.asarray(pose.translation) for pose in run.truth]).reshape(-1, 3) / MM
        truth = line(true[every], "truth", {"color": GREY, "width": 5})
        data.append({**truth, "mode": "markers", "marker": {"color": GREY, "size": 5}} if series.apart else truth)
    colours = {"color": series.t_s[every], "colorscale": "Viridis", "size": 2.5}
    bar = {"title": {"text": series.time_label}, "thickness": 12, "len": 0.7}
    trace = line(xyz[every], "full pose", {"color": BLUE, "width": 2})
    data.append({**trace, "mode": mode, "marker": {**colours, "colorbar": bar}})
    if position.any():
        some = np.flatnonzero(position)[:: max(1, int(position.sum()) // MAX_PLOTTED)]
        marks = line(series.values[some, :3], "position only", {})
        data.append({**marks, "mode": "markers", "marker": {"size": 3, "color": ORANGE}})
    if run.parent == "rig" or run.T_parent_rig is not None:
        hidden = {"visible": "legendonly"} if _is_far(run, xyz) else {}
        depth_m = _apart_m(run) / 3.0
        data += [{**camera_line(run.rig, name, run.T_parent_rig, depth_m=depth_m), **hidden} for name in run.rig.names]
    scene = scene_axes(run.parent)
    return Figure(data=data, layout=layout(scene=scene, uirevision=1), height_px=520)


def _apart_m(run: MeasureRun) -> float:
    """Return a pair's baseline, of other cameras the furthest from the first one; 0.1 m of one alone."""
    if run.rig.is_pair:
        return run.rig.baseline_m
    at = np.array([one.T_rig_camera.translation for one in run.rig.cameras])
    return float(np.linalg.norm(at - at[0], axis=1).max()) or 0.1


def _is_far(run: MeasureRun, xyz: Array) -> bool:
    known = xyz[np.isfinite(xyz[:, 0])]
    if not len(known):
        return False
    size = max(float(np.ptp(known, axis=0).max()), _apart_m(run) / MM)
    eye = np.zeros(3) if run.T_parent_rig is None else run.T_parent_rig.translation / MM
    return float(np.linalg.norm(known.mean(axis=0) - eye)) > FAR * size


def time_figure(series: Series) -> Figure:
    """Return x, y, z, rx, ry, rz over time with their 95 % bands, and marks where there is no full pose."""
    data: list[Plot] = []
    ok, position = series.whole, series.where(PoseStatus.POSITION_ONLY)
    full, std = series.full()
    for k in range(6):
        values, half = full[:, k], WITHIN_95 * std[:, k]
        data += _banded(series, values, values - half, values + half, k)
        data += _marks_below(series.t_s[~ok], k)
        if k < 3 and position.any():
            data.append(_dots(series.t_s[position], series.values[position, k], k))
    return Figure(data=data, layout=_six(TITLES, series.time_label), height_px=640)


def deviation_figure(series: Series, values: Array | None, std: Array) -> Figure:
    """Return deviations (n, 6) within their claimed band over time, std (n, 6); without any, the band's half width."""
    data: list[Plot] = []
    for k in range(6):
        if values is not None:
            half = WITHIN_95 * std[:, k]
            data += _banded(series, values[:, k], -half, half, k)
        else:
            half = WITHIN_95 * series.full()[1][:, k]
            data += _banded(series, half, np.full_like(half, np.nan), half, k)
    titles = [f"Δ{title}" for title in TITLES] if values is not None else [f"± {title}" for title in TITLES]
    shape = _six(titles, series.time_label)
    if values is None:
        for k in range(6):
            shape["yaxis" + subplot(k + 1)["yaxis"][1:]]["rangemode"] = "tozero"
    return Figure(data=data, layout=shape, height_px=640)


def _banded(series: Series, values: Array, low: Array, high: Array, k: int) -> list[Plot]:
    """Return the traces of one of six plots: a band, a line with gaps, marks where a frame stands alone.

    Of single shots it is bars and marks: no line leads from one to the next.
    """
    where: Plot = {**subplot(k + 1), "showlegend": False}
    keep = thinned(np.where(np.isfinite(high), high, values))
    known = np.isfinite(values)
    gaps = np.flatnonzero(~known[1:] & known[:-1]) + 1  # the first frame of each gap, so that lines do not cross it
    keep = np.unique(np.concatenate([keep, thinned(values), gaps[:MAX_PLOTTED]]))
    x, y = series.t_s[keep], values[keep]
    draw = _bars if series.apart else band
    traces = [draw(x, low[keep], high[keep], **where)] if np.isfinite(low).any() else []
    mode = "markers" if series.apart else "lines+markers" if len(keep) <= MARKED else "lines"
    at = "%{x:.3f} s" if series.timed else "frame %{x:.0f}"
    traces.append(
        {
            "type": "scatter",
            "x": x,
            "y": y,
            "mode": mode,
            "line": {"color": BLUE, "width": 1.2},
            "marker": {"size": 3},
            "hovertemplate": at + ": %{y:.4f}<extra></extra>",
            **where,
        }
    )
    alone = [a for a, b in runs(np.isfinite(y)) if b == a + 1]
    if alone and mode == "lines":
        marks = {"mode": "markers", "marker": {"size": 3, "color": BLUE}, "hoverinfo": "skip"}
        traces.append({"type": "scatter", "x": x[alone], "y": y[alone], **marks, **where})
    return traces


def _bars(x: Array, low: Array, high: Array, **more: Any) -> Plot:
    """Return an upright bar from low to high at each x (n,)."""
    gap = np.full_like(x, np.nan)
    xs, ys = np.stack([x, x, gap], axis=1).ravel(), np.stack([low, high, gap], axis=1).ravel()
    return {
        "type": "scatter",
        "x": xs,
        "y": ys,
        "mode": "lines",
        "line": {"color": BAND, "width": 4},
        "hoverinfo": "skip",
        **more,
    }


def _marks_below(t_s: Array, k: int) -> list[Plot]:
    """Return red ticks along the bottom of plot k."""
    if not len(t_s):
        return []
    some = t_s[np.unique(np.linspace(0, len(t_s) - 1, MAX_PLOTTED // 4).astype(int))]
    return [
        {
            "type": "scatter",
            "x": some,
            "y": np.zeros(len(some)),
            **subplot(k + 1, k + 7),
            "mode": "markers",
            "marker": {"symbol": "line-ns", "size": 7, "line": {"color": RED, "width": 1}},
            "hoverinfo": "skip",
            "showlegend": False,
        }
    ]


def _dots(t_s: Array, values: Array, k: int) -> Plot:
    """Return orange dots in plot k."""
    keep = thinned(values)
    marks = {"mode": "markers", "marker": {"size": 3.5, "color": ORANGE}, "hovertemplate": "%{y:.3f}<extra></extra>"}
    return {"type": "scatter", "x": t_s[keep], "y": values[keep], **marks, **subplot(k + 1), "showlegend": False}


def _six(titles: Any, time_label: str) -> Plot:
    """Return the layout of six plots in two columns over one time axis; y7..y12 lie over them for marks."""
    out: Plot = layout(hovermode="x", margin={"l": 60, "r": 16, "t": 12, "b": 40})
    height, gap = 0.29, 0.065
    for k, title in enumerate(titles):
        column, row = divmod(k, 3)
        top = 1.0 - row * (height + gap)
        own, last = subplot(k + 1), row == 2
        out["xaxis" + own["xaxis"][1:]] = axis(
            time_label if last else "",
            domain=[0.0, 0.455] if column == 0 else [0.545, 1.0],
            anchor=own["yaxis"],
            showticklabels=last,
            **({"matches": "x"} if k else {}),
        )
        out["yaxis" + own["yaxis"][1:]] = axis(title, domain=[max(0.0, top - height), top], anchor=own["xaxis"])
        out[f"yaxis{k + 7}"] = {
            "overlaying": own["yaxis"],
            "range": [-0.03, 1.0],
            "visible": False,
            "fixedrange": True,
            "anchor": own["xaxis"],
        }
    return out


NEIGHBOURS = 11
"""Frames in a row through which the smooth track goes: a third of a second of ordinary cameras."""

PARABOLA = np.linalg.pinv(np.vander(np.arange(NEIGHBOURS) - NEIGHBOURS // 2, 3))[2]
"""Weights of the frames in the middle value of the parabola through them."""

AT_REST = 6.0
"""Range of the smoothed values over the claimed standard deviation, up to which nothing moved."""


def scatter_of(series: Series) -> tuple[Array, bool] | None:
    """Return each full pose less the mean at rest, or less the parabola through its NEIGHBOURS in a track, (n, 6) in mm
    and degrees, NaN where nothing can be said; and whether the target rests.

    What a parabola takes along of white noise is put back: its residuals have the share 1 - c of the noise's variance,
    c the weight of the middle frame (Savitzky and Golay 1964). Frames near a gap have no full neighbourhood: NaN.
    None where too few frames stand in a row.
    """
    full, std = series.full()
    smooth = np.full_like(full, np.nan)
    half = NEIGHBOURS // 2
    for start, stop in runs(np.asarray(np.isfinite(full).all(axis=1))):
        if stop - start >= NEIGHBOURS:
            inside = (weight * full[start + k : stop - 2 * half + k] for k, weight in enumerate(PARABOLA))
            smooth[start + half : stop - half] = sum(inside)
    known = np.isfinite(smooth[:, 0])
    if not known.any():
        return None
    typical = np.nanmedian(std[known], axis=0)
    if (np.ptp(smooth[known], axis=0) <= AT_REST * typical).all():
        return full - np.nanmean(full, axis=0), True
    weight = float(PARABOLA[half])
    return (full - smooth) / np.sqrt(1.0 - weight), False
